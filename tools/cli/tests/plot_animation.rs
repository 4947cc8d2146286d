//! `singletrack plot --animate`: a drive from above, in one file without a script.

use std::{fs, path::Path, process::Command};

use crate::recorded::{self, STOPPING, Script};

/// From one frame to the next, and the pause at the end, in s.
const STEP: f64 = 0.1;
const PAUSE: f64 = 1.5;

fn singletrack(arguments: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(arguments)
        .output()
        .unwrap()
}

/// Writes a record and animates it. Returns the picture, or what was said instead, and the files.
fn animate(script: &Script) -> (Result<String, String>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("drive.mcap");
    recorded::write(&record, script);
    let output = singletrack(&["plot", record.to_str().unwrap(), "--animate"]);
    let drawn = folder.path().join("drive");
    let files = fs::read_dir(&drawn).into_iter().flatten();
    let mut files: Vec<String> = files
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    if !output.status.success() {
        return (Err(String::from_utf8(output.stderr).unwrap()), files);
    }
    (
        Ok(fs::read_to_string(drawn.join("animation.svg")).unwrap()),
        files,
    )
}

/// The lists of values of all animations.
fn values(svg: &str) -> Vec<Vec<&str>> {
    let lists = svg.split(" values=\"").skip(1);
    lists
        .map(|list| list.split_once('"').unwrap().0.split(';').collect())
        .collect()
}

/// The places of what follows this animation, one a frame, in m.
fn places_before(svg: &str, what: &str) -> Vec<[f64; 2]> {
    let (before, _) = svg.split_once(what).unwrap();
    let list = values(before).pop().unwrap();
    let place = |text: &&str| {
        let (x, y) = text.split_once(' ').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    };
    list.iter().map(place).collect()
}

#[test]
fn the_animation_is_one_file_and_every_part_of_it_has_every_frame() {
    let (svg, files) = animate(&Script::default());
    let svg = svg.unwrap();
    assert_eq!(files, ["animation.svg"], "the figures were not asked for");
    for wrong in ["NaN", "inf", "<script", "{"] {
        let text: String = svg.split("</style>").skip(1).collect();
        assert!(!text.contains(wrong), "{wrong}");
    }
    // The last tick of the drive is one period before its end.
    let driven = (Script::default().drives[0] + STOPPING - 1) as f64 * 0.01;
    let frames = (driven / STEP).ceil() + (PAUSE / STEP).ceil();
    let seconds = format!("dur=\"{:.1}s\"", frames * STEP);
    let lists = values(&svg);
    assert_eq!(lists.len(), svg.matches("repeatCount").count());
    assert_eq!(lists.len(), svg.matches(&seconds).count(), "{seconds}");
    // Reference, car, yaw, two wheels and P by the steering, trail, time, lost markers.
    assert_eq!(lists.len(), 9);
    for list in lists {
        assert_eq!(list.len() as f64, frames + 1.0);
    }
}

#[test]
fn the_reference_is_where_it_was_and_the_trail_ends_at_p() {
    let svg = animate(&Script::default()).0.unwrap();
    let places = places_before(&svg, "<circle class=\"reference\"");
    for (frame, [x, y]) in places.iter().enumerate().take(100) {
        let [expected_x, expected_y] = recorded::reference(frame as f64 * STEP);
        assert!(
            (x - expected_x).hypot(y - expected_y) < 2e-3,
            "frame {frame}"
        );
    }
    // At first nothing of the path is drawn, at the end all of it: 0.45 m/s.
    let (_, path) = svg.split_once("stroke-dasharray=\"").unwrap();
    let length: f64 = path.split_once('"').unwrap().0.parse().unwrap();
    let expected = recorded::DRIVEN_RADIUS * recorded::ANGULAR_VELOCITY * 10.19;
    assert!(
        (length - expected).abs() < 5e-3,
        "{length} is not {expected}"
    );
    let offsets = &values(path)[0];
    assert_eq!(offsets[0].parse::<f64>().unwrap(), length);
    assert_eq!(offsets.last().unwrap().parse::<f64>().unwrap(), 0.0);
}

#[test]
fn lost_markers_are_said_while_they_are_lost() {
    let svg = animate(&Script::default()).0.unwrap();
    let (_, words) = svg.split_once("markers lost").unwrap();
    let seen: Vec<usize> = values(words)[0]
        .iter()
        .enumerate()
        .filter_map(|(frame, word)| (*word == "visible").then_some(frame))
        .collect();
    // Ticks 200 to 219 had no pose.
    assert_eq!(seen, [20, 21]);
    let all = Script {
        lost: 0..0,
        ..Script::default()
    };
    assert!(!animate(&all).0.unwrap().contains("markers lost"));
}

#[test]
fn a_drive_without_an_estimate_says_why_there_is_no_picture() {
    let (said, files) = animate(&Script {
        estimate: false,
        ..Script::default()
    });
    let said = said.unwrap_err();
    assert!(
        said.contains("no animation: no tick knows where the car was"),
        "{said}"
    );
    assert!(files.is_empty());
}

#[test]
fn the_picture_of_the_readme_is_what_its_scenario_gives() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("circle-car.mcap");
    let scenario = root.join("tools/scenarios/circle-car.toml");
    let (record, out) = (record.to_str().unwrap(), folder.path().to_str().unwrap());
    let simulated = singletrack(&["simulate", scenario.to_str().unwrap(), "--record", record]);
    assert!(simulated.status.success());
    let plotted = singletrack(&["plot", record, "--animate", "--out", out]);
    assert!(plotted.status.success());
    let [new, old] = [
        folder.path().join("animation.svg"),
        root.join("docs/figures/drive/animation.svg"),
    ]
    .map(|path| fs::read_to_string(path).unwrap());
    assert!(
        new == old,
        "draw docs/figures/drive/animation.svg again, by docs/figures.md"
    );
}
