//! What `singletrack import` and `recover` do and say, and what other commands make of an import's records.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Command, Output},
};

use singletrack_record::{
    ClockMapping, Ending, Entry, Level, Log, Meta, Reader, Recorder, part_path,
};

const MAP: &str = "\
[time]
column = \"t\"
unit = \"s\"
unix = false
[pose]
x = \"x\"
y = \"y\"
yaw = \"yaw\"
[motor]
speed = \"v\"
[steering]
column = \"s\"
radians_per_unit = 0.5
";

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

/// A folder with a map and a log of three rows.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let log = "t,x,y,yaw,v,s\n0,1,2,0.5,1,0\n0.01,1,2,0.5,1.5,0.2\n0.02,1,2,0.5,1,0.4\n";
    fs::write(folder.path().join("log.csv"), log).unwrap();
    fs::write(folder.path().join("map.toml"), MAP).unwrap();
    folder
}

const IMPORT: [&str; 6] = [
    "import", "log.csv", "--map", "map.toml", "--out", "out.mcap",
];

#[test]
fn an_import_says_what_it_made_and_dump_prints_the_record() {
    let folder = folder();
    let output = run(folder.path(), &IMPORT);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        text(output.stdout),
        "out.mcap: 0.02 s, 3 poses, 3 board samples of 3 of the motor, 3 ticks; largest gaps: poses \
         0.010 s at 0.000 s, motor 0.010 s at 0.000 s, board samples 0.010 s at 0.000 s\n"
    );
    assert!(output.stderr.is_empty());
    let fields = "time_s,mode,actuation.steering_rad";
    let dump = ["dump", "out.mcap", "--topic", "tick", "--fields", fields];
    assert_eq!(
        text(run(folder.path(), &dump).stdout),
        format!("{fields}\n0.0,driving,0.0\n0.01,driving,0.1\n0.02,driving,0.2\n")
    );

    // Again, and the one that is there is not touched.
    let output = run(folder.path(), &IMPORT);
    assert_eq!(output.status.code(), Some(1));
    let message = text(output.stderr);
    assert!(message.contains("out.mcap exists already"), "{message}");
}

#[test]
fn an_import_that_fails_names_the_place_and_leaves_no_record() {
    let folder = folder();
    fs::write(
        folder.path().join("log.csv"),
        "t,x,y,yaw,v,s\n0,1,2,0.5,fast,0\n",
    )
    .unwrap();
    let output = run(folder.path(), &IMPORT);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        text(output.stderr),
        "singletrack: log.csv, line 2, column \"v\": \"fast\" is not a number: correct the cell or \
         remove the row\n"
    );
    let names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn an_imported_record_has_nothing_to_replay() {
    let folder = folder();
    assert!(run(folder.path(), &IMPORT).status.success());
    let output = run(folder.path(), &["replay", "out.mcap"]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        text(output.stderr),
        "singletrack: out.mcap was imported from the log of another program: no pilot made it, so \
         there is nothing to repeat\n"
    );
}

/// Leaves `drive.mcap.part`, cut within its second chunk.
fn cut_record(folder: &Path) {
    let meta = Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: 1,
        seed: None,
        start: ClockMapping {
            monotonic_ns: 0,
            wall_ns: 0,
        },
    };
    let path = folder.join("drive.mcap");
    let mut recorder = Recorder::create(&path, &meta).unwrap();
    for second in 0..3 {
        recorder
            .write(&Entry::Log(Log {
                time_ns: second * 1_000_000_000,
                level: Level::Info,
                text: "tick".to_owned(),
            }))
            .unwrap();
        if second == 1 {
            recorder.flush().unwrap();
        }
    }
    recorder.flush().unwrap();
    // Before it is dropped, which completes the file.
    let bytes = fs::read(part_path(&path)).unwrap();
    drop(recorder);
    fs::write(part_path(&path), &bytes[..bytes.len() - 200]).unwrap();
}

#[test]
fn a_truncated_record_is_renamed_with_a_report_of_saved_and_lost_data() {
    let folder = tempfile::tempdir().unwrap();
    cut_record(folder.path());
    let output = run(folder.path(), &["recover", "drive.mcap.part"]);
    assert!(output.status.success(), "{output:?}");
    let told = String::from_utf8(output.stdout).unwrap();
    assert!(
        told.starts_with("drive.mcap: saved 2 entries (4 messages) of 1.00 s\nlost the end: "),
        "{told}"
    );
    assert!(output.stderr.is_empty());
    let mut reader = Reader::open(&folder.path().join("drive.mcap")).unwrap();
    assert_eq!(reader.by_ref().map(Result::unwrap).count(), 2);
    assert_eq!(reader.ending, Some(Ending::Finished));
    assert!(folder.path().join("drive.mcap.part").exists());

    // Again, and the one that is there is not touched.
    let output = run(folder.path(), &["recover", "drive.mcap.part"]);
    assert!(!output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("drive.mcap exists already"), "{told}");
    let output = run(
        folder.path(),
        &["recover", "drive.mcap.part", "--out", "other.mcap"],
    );
    assert!(output.status.success(), "{output:?}");
    let output = run(folder.path(), &["recover", "other.mcap"]);
    let told = String::from_utf8(output.stdout).unwrap();
    assert_eq!(
        told,
        "other.recovered.mcap: saved 2 entries (4 messages) of 1.00 s\nlost nothing\n"
    );
}

#[test]
fn an_empty_file_is_said_to_be_one() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("drive.mcap.part"), "").unwrap();
    let output = run(folder.path(), &["recover", "drive.mcap.part"]);
    assert!(!output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(
        told,
        "singletrack: drive.mcap.part ends after 0 bytes, before its first entry: nothing was recorded\n"
    );
}
