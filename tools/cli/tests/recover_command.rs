//! What `singletrack recover` does and says.

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

fn recover(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("recover")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
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
    let output = recover(folder.path(), &["drive.mcap.part"]);
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
    let output = recover(folder.path(), &["drive.mcap.part"]);
    assert!(!output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("drive.mcap exists already"), "{told}");
    let output = recover(folder.path(), &["drive.mcap.part", "--out", "other.mcap"]);
    assert!(output.status.success(), "{output:?}");
    let output = recover(folder.path(), &["other.mcap"]);
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
    let output = recover(folder.path(), &["drive.mcap.part"]);
    assert!(!output.status.success());
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(
        told,
        "singletrack: drive.mcap.part ends after 0 bytes, before its first entry: nothing was recorded\n"
    );
}
