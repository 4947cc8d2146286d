//! Runs the targets on the corpus, which is compared with the generator, and on random bytes, for a few
//! seconds with every `cargo test`.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use proptest::{collection::vec, prelude::*, test_runner::FileFailurePersistence};
use singletrack_fuzz::{TARGETS, seeds::seeds};

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(target)
}

fn files(target: &str) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder(target))
        .unwrap()
        .map(|entry| {
            let entry = entry.unwrap();
            let name = entry.file_name().into_string().unwrap();
            (name, fs::read(entry.path()).unwrap())
        })
        .collect();
    files.sort();
    files
}

#[test]
fn no_file_of_the_corpus_violates_an_invariant() {
    for target in TARGETS {
        for (name, bytes) in files(target.name) {
            // Shown on failure.
            println!("{}/{name}", target.name);
            (target.run)(&bytes);
        }
    }
}

#[test]
fn the_corpus_is_the_generated_one_plus_findings() {
    for target in TARGETS {
        let mut expected: Vec<_> = seeds(target.name)
            .into_iter()
            .map(|seed| (seed.name, seed.bytes))
            .collect();
        expected.sort();
        let mut committed = files(target.name);
        committed.retain(|(name, _)| !name.starts_with("found-"));
        assert!(
            committed == expected,
            "{} differs: run cargo run -p singletrack-fuzz --example seeds",
            folder(target.name).display()
        );
    }
}

#[test]
fn the_corpus_stays_small() {
    let length: usize = TARGETS
        .iter()
        .flat_map(|target| files(target.name))
        .map(|(_, bytes)| bytes.len())
        .sum();
    assert!(length < 200_000, "{length} bytes");
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/targets.proptest-regressions",
        ))),
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(1_000))]

    #[test]
    fn random_bytes_to_the_board_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::board_bytes(&data);
    }

    #[test]
    fn random_bytes_to_the_host_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::host_bytes(&data);
    }

    #[test]
    fn random_datagrams_violate_no_invariant(data in vec(any::<u8>(), 0..600)) {
        singletrack_fuzz::natnet_packets(&data);
    }

    #[test]
    fn random_text_is_a_valid_configuration_or_refused_with_a_message(
        changes: bool,
        mut data in vec(any::<u8>(), 0..40),
    ) {
        data.insert(0, changes.into());
        singletrack_fuzz::configuration(&data);
    }

    #[test]
    fn random_lines_are_commands_or_refused_with_a_message(
        object: bool,
        mut data in vec(any::<u8>(), 0..60),
    ) {
        data.insert(0, object.into());
        singletrack_fuzz::control_line(&data);
    }

    #[test]
    fn random_heads_are_requests_or_refused(
        parts: bool,
        mut data in vec(any::<u8>(), 0..80),
    ) {
        data.insert(0, parts.into());
        singletrack_fuzz::page_head(&data);
    }

    #[test]
    fn random_messages_of_streams_make_no_false_pose(data in vec(any::<u8>(), 0..400)) {
        singletrack_fuzz::stream_messages(&data);
    }
}
