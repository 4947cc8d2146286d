//! The fault campaign: several cars, and the command in shards: what is joined is what one process
//! gives.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod planted;
mod schedules;

use std::{
    fs,
    path::PathBuf,
    process::{Command, Output},
};

use singletrack_campaign::merge_files;
use singletrack_faults::{FleetBug, drive_fleet};

fn faults(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack-faults"));
    command.args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn options_that_exclude_each_other_are_refused() {
    for arguments in [
        ["--from", "a", "--shard", "1/2"],
        ["--record", "a", "--shard", "1/2"],
        ["--replay", "a", "--json", "b"],
        ["--print", "--threads", "1", "--shard=1/2"],
        ["--count", "1", "--shard", "0/2"],
    ] {
        let refused = faults(&arguments);
        assert_eq!(refused.status.code(), Some(2), "{arguments:?} {refused:?}");
    }
    let refused = faults(&["--from", "/missing.jsonl"]);
    assert!(
        text(&refused.stderr).contains("/missing.jsonl"),
        "{refused:?}"
    );
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn shards_give_file_and_report_of_one_process_to_the_byte() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        // Seed 50 is run twice.
        let seeds = ["--first-seed", "46", "--count", "7"];
        let whole = path("whole.jsonl");
        let one = faults(&[&seeds[..], &["--threads", "1", "--json", &whole]].concat());
        assert!(one.status.success(), "{one:?}");
        let parts = ["1/3", "2/3", "3/3"].map(|shard| {
            let file = path(&shard.replace('/', "-"));
            let part = faults(&[&seeds[..], &["--shard", shard, "--json", &file]].concat());
            assert!(part.status.success(), "{part:?}");
            let count = if shard == "1/3" { 3 } else { 2 };
            assert!(text(&part.stdout).contains(&format!("\n{count} schedules, 0 violations")));
            file
        });
        let merged = merge_files(&parts.clone().map(PathBuf::from)).unwrap();
        let whole_text = fs::read_to_string(&whole).unwrap();
        assert_eq!(merged.text().unwrap(), whole_text);
        let from = |files: &[&str]| faults(&[&["--from"], files].concat());
        for report in [from(&[&whole]), from(&parts.each_ref().map(String::as_str))] {
            assert_eq!(report, one);
        }

        // A violation survives the file, and so does the exit status.
        let lines: Vec<&str> = whole_text.lines().collect();
        let failing = lines[3].replacen(
            "\"failure\":null",
            "\"failure\":{\"schedule\":\"seed 48; end_ms 3000; ask arm at 2500\",\
             \"invariant\":\"fence\",\"time_us\":2600000,\"details\":\"planted\"}",
            1,
        );
        assert_ne!(failing, lines[3]);
        let failed = path("failed.jsonl");
        fs::write(&failed, whole_text.replace(lines[3], &failing)).unwrap();
        let report = from(&[&failed, "--no-shrink"]);
        assert_eq!(report.status.code(), Some(1), "{report:?}");
        let report = text(&report.stdout);
        assert!(
            report.contains("seed 48 violates fence at 2600 ms: planted"),
            "{report}"
        );
        assert!(report.ends_with("7 schedules, 1 violations\n"), "{report}");
    }
}

#[test]
fn a_schedule_of_several_cars_gives_the_same_bits_again_and_no_two_touch() {
    for seed in 0..4 {
        let outcome = drive_fleet(seed, 3, None).unwrap();
        assert_eq!(outcome.failure, None, "{seed}");
        assert_eq!(outcome, drive_fleet(seed, 3, None).unwrap());
    }
}

#[test]
fn cars_that_do_not_look_at_each_other_touch() {
    let found = (0..6).any(|seed| {
        let outcome = drive_fleet(seed, 3, Some(FleetBug::Blind)).unwrap();
        outcome.failure.is_some()
    });
    assert!(found);
}
