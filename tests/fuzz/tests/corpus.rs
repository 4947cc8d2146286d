//! Replays the corpus, and compares it with the generator.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

use std::{
    fs,
    path::{Path, PathBuf},
};

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
