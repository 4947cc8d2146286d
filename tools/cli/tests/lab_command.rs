//! `singletrack lab`, as students and teachers call it.

use std::{fs, path::Path, process::Command};

use serde_json::Value;

/// The exit status, standard output and standard error.
fn lab(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("lab")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn a_lab_is_shown_answered_and_marked() {
    let folder = tempfile::tempdir().unwrap();
    let show = ["show", "1", "--student", "Ada \"the first\" Lovelace"];
    let (status, shown, _) = lab(folder.path(), &show);
    assert_eq!(status, Some(0));
    let sheet = folder.path().join("lab-1.toml");
    let template = fs::read_to_string(&sheet).unwrap();
    for id in ["1.1", "1.2", "1.3", "1.4", "1.5", "1.6"] {
        assert!(shown.contains(&format!("\n{id} (")), "{shown}");
        assert!(template.contains(&format!("# {id} (")), "{template}");
    }
    let answered = template.replace("lag_rad = \"?\"", "lag_rad = 9.0");
    fs::write(&sheet, &answered).unwrap();
    // Shown again, the answers stay.
    let (status, again, _) = lab(folder.path(), &show);
    assert_eq!(status, Some(0));
    assert!(again.contains("left as it is"), "{again}");
    assert_eq!(fs::read_to_string(&sheet).unwrap(), answered);

    let (status, marks, _) = lab(folder.path(), &["mark", "lab-1.toml"]);
    assert_eq!(status, Some(0));
    for word in [
        "1.2  wrong, 0 of 2 points",
        "lag_rad = 9 (rad)",
        "within 1 %",
        "Hint:",
        "0 of 15 points",
    ] {
        assert!(marks.contains(word), "{word}: {marks}");
    }
    let (status, marks, _) = lab(folder.path(), &["mark", "lab-1.toml", "--json"]);
    assert_eq!(status, Some(0));
    let marks: Value = serde_json::from_str(&marks).unwrap();
    assert_eq!(marks["student"], "Ada \"the first\" Lovelace");
    assert_eq!((&marks["points"], &marks["of"]), (&0.into(), &15.into()));
    assert_eq!(marks["marks"][0]["grade"], "open");
    assert_eq!(marks["marks"][1]["grade"], "wrong");
}

#[test]
fn a_sheet_that_cannot_be_read_is_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (status, _, error) = lab(folder.path(), &["mark", "none.toml"]);
    assert_eq!(status, Some(1));
    assert!(
        error.contains("none.toml") && error.contains("lab show"),
        "{error}"
    );
    let bad = "lab = 1\nstudent = \"Ada\"\n[answers]\nlag_rad = \"0.4 rad\"\n";
    fs::write(folder.path().join("bad.toml"), bad).unwrap();
    let (status, out, error) = lab(folder.path(), &["mark", "bad.toml"]);
    assert_eq!((status, out.as_str()), (Some(1), ""));
    assert!(
        error.contains("bad.toml") && error.contains("lag_rad"),
        "{error}"
    );
    let (status, ..) = lab(folder.path(), &["show", "4", "--student", "Ada"]);
    assert_eq!(status, Some(2));
    let (status, _, error) = lab(folder.path(), &["show", "1", "--student", "-"]);
    assert_eq!(status, Some(1));
    assert!(error.contains("student"), "{error}");
}
