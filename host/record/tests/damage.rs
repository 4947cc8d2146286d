//! Files that are unfinished, truncated, damaged, or no records.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use std::{fs, path::PathBuf};

use proptest::prelude::*;
use singletrack_record::{Ending, Entry, Reader, RecordError, Recorder, part_path};

use crate::common;

const FLUSHES: u64 = 5;
const ENTRIES_A_FLUSH: u64 = 20;

/// The bytes of a record that a killed process leaves, and their length after each flush.
fn unfinished() -> (Vec<u8>, Vec<u64>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let mut recorder = Recorder::create(&path, &common::meta()).unwrap();
    let mut lengths = Vec::new();
    for flush in 0..FLUSHES {
        for entry in 0..ENTRIES_A_FLUSH {
            recorder
                .write(&common::log(flush * ENTRIES_A_FLUSH + entry))
                .unwrap();
        }
        recorder.flush().unwrap();
        lengths.push(fs::metadata(part_path(&path)).unwrap().len());
    }
    let bytes = fs::read(part_path(&path)).unwrap();
    (bytes, lengths)
}

struct Read {
    entries: Vec<Entry>,
    error: Option<RecordError>,
    ending: Option<Ending>,
}

fn read(bytes: &[u8]) -> Result<Read, RecordError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap.part");
    fs::write(&path, bytes).unwrap();
    let mut reader = Reader::open(&path)?;
    let mut entries = Vec::new();
    let mut error = None;
    for entry in reader.by_ref() {
        match entry {
            Ok(entry) => entries.push(entry),
            Err(failure) => error = Some(failure),
        }
    }
    Ok(Read {
        entries,
        error,
        ending: reader.ending,
    })
}

fn logs(count: u64) -> Vec<Entry> {
    (0..count).map(common::log).collect()
}

#[test]
fn an_unfinished_record_is_read_up_to_its_last_flush() {
    let (bytes, _) = unfinished();
    let read = read(&bytes).unwrap();
    assert_eq!(read.entries, logs(FLUSHES * ENTRIES_A_FLUSH));
    assert!(read.error.is_none());
    let ending = read.ending.unwrap();
    assert_eq!(
        ending,
        Ending::Unfinished {
            entries: 100,
            bytes: bytes.len() as u64
        }
    );
    assert!(
        ending
            .to_string()
            .contains("unfinished: it stops after 100 entries")
    );
}

proptest! {
    #[test]
    fn a_truncated_record_gives_every_whole_flush_and_its_end(
        cut in any::<prop::sample::Index>(),
    ) {
        let (bytes, lengths) = unfinished();
        let cut = cut.index(bytes.len());
        match read(&bytes[..cut]) {
            Ok(read) => {
                prop_assert!(read.error.is_none(), "{:?}", read.error);
                let whole = lengths.iter().filter(|length| **length <= cut as u64).count() as u64;
                let count = read.entries.len() as u64;
                prop_assert!(count >= whole * ENTRIES_A_FLUSH, "{count}");
                prop_assert_eq!(read.entries, logs(count));
                let unfinished = Ending::Unfinished { entries: count, bytes: cut as u64 };
                prop_assert_eq!(read.ending, Some(unfinished));
            }
            Err(error) => {
                let empty = matches!(error, RecordError::Empty { bytes, .. } if bytes == cut as u64);
                prop_assert!(empty, "{error}");
                prop_assert!(lengths.iter().all(|length| (cut as u64) < *length));
            }
        }
    }

    #[test]
    fn flipped_bits_cause_no_panic_and_no_wrong_entry(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8_u8), 1..4),
    ) {
        let (mut bytes, _) = unfinished();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        if let Ok(read) = read(&bytes) {
            // The checksums of the chunks make every entry read a true one.
            let whole = logs(FLUSHES * ENTRIES_A_FLUSH);
            prop_assert!(read.entries.iter().all(|entry| whole.contains(entry)));
        }
    }

    #[test]
    fn arbitrary_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(read(&bytes).is_err());
        let with_magic = [mcap::MAGIC, &bytes].concat();
        prop_assert!(read(&with_magic).is_err());
    }
}

#[test]
fn a_finished_record_without_its_end_is_unfinished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    common::record(&path, &logs(3));
    let bytes = fs::read(&path).unwrap();
    let read = read(&bytes[..bytes.len() - 1]).unwrap();
    assert_eq!(read.entries, logs(3));
    assert!(matches!(
        read.ending,
        Some(Ending::Unfinished { entries: 3, .. })
    ));
}

#[test]
fn damage_in_a_chunk_is_reported_with_the_entries_before_it() {
    let (mut bytes, lengths) = unfinished();
    // After the header of the chunk, in its compressed messages.
    bytes[lengths[2] as usize + 90] ^= 0x10;
    let read = read(&bytes).unwrap();
    assert_eq!(read.entries, logs(3 * ENTRIES_A_FLUSH));
    let error = read.error.unwrap().to_string();
    assert!(error.contains("is damaged after 60 entries"), "{error}");
    assert_eq!(read.ending, None);
}

fn foreign(
    name: &str,
    write: impl FnOnce(&mut mcap::Writer<fs::File>),
    profile: &str,
) -> RecordError {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(name);
    let mut writer = mcap::WriteOptions::new()
        .profile(profile)
        .library("rosbag2")
        .create(fs::File::create(&path).unwrap())
        .unwrap();
    write(&mut writer);
    writer.finish().unwrap();
    drop(writer);
    Reader::open(&path).err().unwrap()
}

#[test]
fn each_kind_of_other_file_has_its_own_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.txt");
    fs::write(&path, "these are only some notes").unwrap();
    let error = Reader::open(&path).err().unwrap();
    assert!(matches!(error, RecordError::NotMcap(_)), "{error}");
    assert!(error.to_string().contains("notes.txt is not an MCAP file"));

    let missing = Reader::open(&folder.path().join("gone.mcap"))
        .err()
        .unwrap();
    assert!(missing.to_string().contains("can't open"), "{missing}");
    assert!(missing.to_string().contains("gone.mcap"), "{missing}");

    let bag = foreign(
        "bag.mcap",
        |writer| {
            writer
                .add_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
                .unwrap();
        },
        "ros2",
    );
    assert!(bag.to_string().contains("of \"rosbag2\""), "{bag}");
    let other = foreign("other.mcap", |_| {}, "");
    assert!(matches!(other, RecordError::NotOurs { .. }), "{other}");
}

#[test]
fn a_record_of_another_version_is_refused_by_number() {
    let error = foreign(
        "future.mcap",
        |writer| {
            let metadata = [("record_version".to_owned(), "15".to_owned())];
            writer
                .write_metadata(&mcap::records::Metadata {
                    name: "singletrack".to_owned(),
                    metadata: metadata.into(),
                })
                .unwrap();
        },
        "ros2",
    );
    assert!(
        error
            .to_string()
            .contains("version 15; this program reads version 14"),
        "{error}"
    );
}
