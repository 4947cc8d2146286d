//! A process that is killed while it changes the configuration leaves the old file or the new
//! one.

use std::{
    env, fs,
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use singletrack_commissioning::edit::Edit;
use singletrack_core::Config;

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

/// The folder of the process that is killed; in the test itself there is none.
const FOLDER: &str = "SINGLETRACK_TEST_FOLDER";

/// Changes the file for ever.
fn change(path: &Path) {
    for value in (1_500..1_600).cycle() {
        let mut edit = Edit::read(path).unwrap();
        edit.set("board.servo.centre_us", &value.into()).unwrap();
        if let Some(kept) = edit.write(path, "2026-01-02").unwrap() {
            fs::remove_file(kept).unwrap();
        }
    }
}

#[test]
fn a_killed_process_leaves_the_old_file_or_the_new_one() {
    if let Some(folder) = env::var_os(FOLDER) {
        change(&Path::new(&folder).join("car.toml"));
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("car.toml");
    fs::write(&path, EXAMPLE).unwrap();
    for kill in 0..40_u64 {
        let mut child = Command::new(env::current_exe().unwrap())
            .env(FOLDER, folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let before = fs::read_to_string(&path).unwrap();
        let begun = Instant::now();
        while fs::read_to_string(&path).unwrap() == before {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing changes");
            thread::sleep(Duration::from_millis(1));
        }
        // Another moment of a change each time: it takes some milliseconds.
        thread::sleep(Duration::from_micros(331 * kill));
        child.kill().unwrap();
        child.wait().unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let value = Config::read(&path).unwrap().board.servo.centre_us;
        let expected = EXAMPLE.replace("centre_us = 1500", &format!("centre_us = {value}"));
        assert!(text == expected, "after kill {kill}: {text}");
    }
}
