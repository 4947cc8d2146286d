//! A truncated or damaged record gives a complete one with all whole parts.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use std::{
    fs,
    path::{Path, PathBuf},
    sync::LazyLock,
};

use proptest::prelude::*;
use singletrack_record::{
    Ending, Entry, Reader, RecordError, Recorder, Recovery, part_path, recover,
};
use tempfile::TempDir;

use crate::common;

const FLUSHES: u64 = 4;
const ENTRIES_A_FLUSH: u64 = 10;

/// The bytes of a record that a killed process leaves, and their length after each flush.
fn unfinished() -> (Vec<u8>, Vec<usize>) {
    static UNFINISHED: LazyLock<(Vec<u8>, Vec<usize>)> = LazyLock::new(write_unfinished);
    UNFINISHED.clone()
}

fn write_unfinished() -> (Vec<u8>, Vec<usize>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let mut recorder = Recorder::create(&path, &common::meta()).unwrap();
    let length = || fs::metadata(part_path(&path)).unwrap().len() as usize;
    let mut lengths = Vec::new();
    for entry in 0..FLUSHES * ENTRIES_A_FLUSH {
        recorder.write(&common::log(entry)).unwrap();
        if (entry + 1) % ENTRIES_A_FLUSH == 0 {
            recorder.flush().unwrap();
            lengths.push(length());
        }
    }
    (fs::read(part_path(&path)).unwrap(), lengths)
}

fn logs(flushes: impl IntoIterator<Item = u64>) -> Vec<Entry> {
    flushes
        .into_iter()
        .flat_map(|flush| flush * ENTRIES_A_FLUSH..(flush + 1) * ENTRIES_A_FLUSH)
        .map(common::log)
        .collect()
}

/// A folder with a record to recover.
struct Case {
    folder: TempDir,
}

impl Case {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn input(&self) -> PathBuf {
        self.folder.path().join("drive.mcap.part")
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("drive.mcap")
    }

    /// Recovers these bytes, and reads the result to its end.
    fn recover(&self, bytes: &[u8]) -> Result<(Recovery, Vec<Entry>), RecordError> {
        fs::write(self.input(), bytes).unwrap();
        let result = recover(&self.input(), &self.output(), |_, _| {});
        assert_eq!(fs::read(self.input()).unwrap(), bytes, "the old one stays");
        match result {
            Ok(recovery) => {
                let entries = read_to_its_end(&self.output());
                assert_eq!(recovery.entries, entries.len() as u64);
                fs::remove_file(self.output()).unwrap();
                Ok((recovery, entries))
            }
            Err(error) => {
                let left = fs::read_dir(self.folder.path()).unwrap().count();
                assert_eq!(left, 1, "nothing but the old one");
                Err(error)
            }
        }
    }
}

fn read_to_its_end(path: &Path) -> Vec<Entry> {
    let mut reader = Reader::open(path).unwrap();
    let entries = reader.by_ref().map(Result::unwrap).collect();
    assert_eq!(reader.ending, Some(Ending::Finished));
    entries
}

#[test]
fn a_killed_record_becomes_a_complete_one_with_an_index() {
    let case = Case::new();
    let (bytes, _) = unfinished();
    fs::write(case.input(), &bytes).unwrap();
    let mut progress = Vec::new();
    let recovery = recover(&case.input(), &case.output(), |done, of| {
        progress.push((done, of));
    })
    .unwrap();
    assert!(progress.is_sorted());
    assert_eq!(
        progress.last(),
        Some(&(bytes.len() as u64, bytes.len() as u64))
    );

    assert_eq!(recovery.entries, 40);
    // Each line of the log is on the topic for other tools as well.
    assert_eq!(recovery.messages, 80);
    let start = common::meta().start;
    let span = (start.wall_ns_at(0), start.wall_ns_at(39));
    assert_eq!(recovery.span_ns, Some(span));
    assert!(!recovery.complete && recovery.cut_bytes == 0 && recovery.damaged_places == 0);
    assert!(
        recovery.to_string().contains("saved 40 entries"),
        "{recovery}"
    );

    let reader = Reader::open(&case.output()).unwrap();
    assert_eq!(&reader.meta, &common::meta());
    assert_eq!(read_to_its_end(&case.output()), logs(0..FLUSHES));
    let written = fs::read(case.output()).unwrap();
    assert_eq!(recovery.bytes, written.len() as u64);
    let summary = mcap::Summary::read(&written).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, 80);
    assert!(!summary.chunk_indexes.is_empty());
    // The metadata of the record and that of the repair.
    assert_eq!(summary.metadata_indexes.len(), 2);
}

#[test]
fn a_truncated_record_gives_at_least_its_whole_chunks() {
    let (bytes, lengths) = unfinished();
    let case = Case::new();
    // Every place near the end of a chunk, and one in 17 elsewhere.
    let near = |cut: usize| lengths.iter().any(|length| length.abs_diff(cut) <= 12);
    for cut in (0..=bytes.len()).filter(|cut| cut % 17 == 0 || *cut < 12 || near(*cut)) {
        let whole = lengths.iter().filter(|length| **length <= cut).count() as u64;
        match case.recover(&bytes[..cut]) {
            Ok((recovery, entries)) => {
                assert!(entries.len() as u64 >= whole * ENTRIES_A_FLUSH, "at {cut}");
                assert_eq!(entries, logs(0..FLUSHES)[..entries.len()], "at {cut}");
                assert!(!recovery.complete && recovery.damaged_places == 0);
                assert!(recovery.cut_bytes < cut as u64);
            }
            Err(error) => {
                assert!(
                    matches!(error, RecordError::Empty { bytes, .. } if bytes == cut as u64),
                    "at {cut}: {error}"
                );
                assert_eq!(whole, 0, "at {cut}");
            }
        }
    }
}

#[test]
fn a_finished_record_is_copied_unchanged() {
    let case = Case::new();
    let path = case.folder.path().join("other.mcap");
    common::record(&path, &logs(0..2));
    let bytes = fs::read(&path).unwrap();
    fs::remove_file(&path).unwrap();
    let (recovery, entries) = case.recover(&bytes).unwrap();
    assert!(recovery.nothing_lost());
    assert!(recovery.to_string().ends_with("lost nothing"));
    assert_eq!(entries, logs(0..2));
    // Without its index, the record has the same entries.
    let (_, entries) = case.recover(&bytes[..bytes.len() - 100]).unwrap();
    assert_eq!(entries, logs(0..2));
}

#[test]
fn an_unwritten_end_costs_nothing_before_it() {
    let (bytes, lengths) = unfinished();
    let case = Case::new();
    let cut = &bytes[..lengths[1] + 40];
    for tail in [vec![0; 5_000], (0..5_000).map(|byte| byte as u8).collect()] {
        let (recovery, entries) = case.recover(&[cut, &tail].concat()).unwrap();
        assert_eq!(entries, logs(0..2));
        assert_eq!(recovery.cut_bytes, 5_040);
        assert_eq!(recovery.damaged_places, 0);
        assert!(recovery.to_string().contains("5040 bytes are not whole"));
    }
}

#[test]
fn a_damaged_chunk_costs_only_itself() {
    let (bytes, lengths) = unfinished();
    let case = Case::new();
    let mut flipped = bytes.clone();
    flipped[lengths[0] + 90] ^= 1;
    let (recovery, entries) = case.recover(&flipped).unwrap();
    assert_eq!(entries, logs([0, 2, 3]));
    assert_eq!(recovery.damaged_places, 1);
    assert!(recovery.damaged_bytes > 0);
    assert!(recovery.to_string().contains("1 damaged places"));

    // A hole that includes the head and the length.
    let mut hole = bytes.clone();
    hole[lengths[0] - 20..lengths[0] + 50].fill(0);
    let (recovery, entries) = case.recover(&hole).unwrap();
    assert_eq!(entries, logs([0, 2, 3]));
    assert_eq!(recovery.damaged_places, 1);

    // A length that reaches into the next part. The chunk itself is whole.
    let mut longer = bytes;
    longer[lengths[0] + 2] += 1;
    let (recovery, entries) = case.recover(&longer).unwrap();
    assert_eq!(entries, logs(0..FLUSHES));
    assert!(recovery.damaged_places <= 1);
}

#[test]
fn a_file_without_a_record_is_refused_with_a_reason_and_leaves_no_file() {
    let case = Case::new();
    let empty = case.recover(b"").unwrap_err().to_string();
    assert!(empty.contains("ends after 0 bytes"), "{empty}");
    let text = case.recover(b"some notes of mine").unwrap_err();
    assert!(matches!(text, RecordError::NotMcap(_)), "{text}");
    let zeros = case.recover(&[0; 4_096]).unwrap_err();
    assert!(matches!(zeros, RecordError::NotMcap(_)), "{zeros}");

    let mut foreign = Vec::new();
    let mut writer = mcap::WriteOptions::new()
        .profile("ros2")
        .library("rosbag2")
        .create(std::io::Cursor::new(&mut foreign))
        .unwrap();
    writer.finish().unwrap();
    drop(writer);
    let foreign = case.recover(&foreign).unwrap_err().to_string();
    assert!(foreign.contains("of \"rosbag2\""), "{foreign}");

    let gone = case.folder.path().join("gone.mcap.part");
    let gone = recover(&gone, &case.output(), |_, _| {}).unwrap_err();
    assert!(gone.to_string().contains("gone.mcap.part"), "{gone}");
}

#[test]
fn no_file_is_overwritten() {
    let case = Case::new();
    fs::write(case.input(), unfinished().0).unwrap();
    fs::write(case.output(), "mine").unwrap();
    let error = recover(&case.input(), &case.output(), |_, _| {}).unwrap_err();
    assert!(matches!(error, RecordError::Exists(_)), "{error}");
    assert_eq!(fs::read(case.output()).unwrap(), b"mine");
}

#[test]
fn what_a_killed_repair_left_does_not_keep_the_next_one_out() {
    let case = Case::new();
    let left = case.folder.path().join("drive.mcap.recovering");
    fs::write(&left, "half").unwrap();
    let (recovery, _) = case.recover(&unfinished().0).unwrap();
    assert!(recovery.entries > 0 && !left.exists());
    // One that is under way holds the lock of its file.
    let busy = fs::File::create_new(&left).unwrap();
    busy.lock().unwrap();
    let refused = recover(&case.input(), &case.output(), |_, _| {}).unwrap_err();
    assert!(matches!(refused, RecordError::Busy(_)), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn flipped_bits_cause_no_panic_and_no_wrong_entry(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8_u8), 1..6),
    ) {
        let (mut bytes, _) = unfinished();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("a.part"), folder.path().join("b"));
        fs::write(&input, bytes).unwrap();
        if recover(&input, &output, |_, _| {}).is_ok()
            // The metadata may be the damaged part.
            && let Ok(reader) = Reader::open(&output)
        {
            let whole = logs(0..FLUSHES);
            for entry in reader {
                prop_assert!(whole.contains(&entry.unwrap()));
            }
        }
    }

    #[test]
    fn arbitrary_bytes_cause_no_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("a.part"), folder.path().join("b"));
        let head = &unfinished().0[..40];
        fs::write(&input, [head, &bytes].concat()).unwrap();
        let refused = recover(&input, &output, |_, _| {}).is_err();
        prop_assert!(refused);
    }
}

/// The offsets of the parts of a file, up to the end of the data.
fn parts(bytes: &[u8]) -> Vec<usize> {
    const MAGIC_LENGTH: usize = 8;
    const DATA_END: u8 = 0x0f;
    let mut at = MAGIC_LENGTH;
    let mut parts = Vec::new();
    while let Some((&opcode, rest)) = bytes.get(at..).and_then(<[u8]>::split_first) {
        parts.push(at);
        let length = u64::from_le_bytes(*rest.first_chunk().unwrap());
        at += 9 + usize::try_from(length).unwrap();
        if opcode == DATA_END {
            break;
        }
    }
    parts
}

#[test]
fn the_loss_of_a_part_with_another_opcode_is_always_reported() {
    let case = Case::new();
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.mcap");
    let mut recorder = Recorder::create(&whole, &common::meta()).unwrap();
    for entry in 0..FLUSHES * ENTRIES_A_FLUSH {
        recorder.write(&common::log(entry)).unwrap();
        if (entry + 1) % ENTRIES_A_FLUSH == 0 {
            recorder.flush().unwrap();
        }
    }
    recorder.finish().unwrap();
    let whole = fs::read(&whole).unwrap();
    let all = logs(0..FLUSHES);
    let (recovery, entries) = case.recover(&whole).unwrap();
    assert!(recovery.nothing_lost() && entries == all);
    let parts = parts(&whole);
    assert!(parts.len() > 10, "{parts:?}");
    for at in parts {
        for bit in 0..8 {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << bit;
            fs::write(case.input(), &bytes).unwrap();
            if let Ok(recovery) = recover(&case.input(), &case.output(), |_, _| {}) {
                assert!(!recovery.nothing_lost(), "bit {bit} at {at}: {recovery}");
                let opens = Reader::open(&case.output()).is_ok();
                assert_eq!(
                    opens,
                    recovery.has_metadata && recovery.has_configuration,
                    "bit {bit} at {at}: {recovery}"
                );
                fs::remove_file(case.output()).unwrap();
            }
            // A reader of the damaged file reports it as well.
            fs::write(case.output(), &bytes).unwrap();
            if let Ok(reader) = Reader::open(&case.output()) {
                let read: Result<Vec<_>, _> = reader.collect();
                assert!(
                    read.is_err() || read.is_ok_and(|read| read == all),
                    "bit {bit} at {at}"
                );
            }
            fs::remove_file(case.output()).unwrap();
        }
    }
}

#[test]
fn missing_messages_between_others_are_counted() {
    let case = Case::new();
    let (bytes, lengths) = unfinished();
    // A second cut out of the record.
    let cut = [&bytes[..lengths[0]], &bytes[lengths[1]..]].concat();
    let (recovery, entries) = case.recover(&cut).unwrap();
    assert_eq!(entries, logs([0, 2, 3]));
    // Lines of the log, on their own topic and on that of ROS.
    assert_eq!(recovery.missing, 2 * ENTRIES_A_FLUSH);
    assert!(!recovery.nothing_lost());
    assert!(
        recovery.to_string().contains("20 messages between others"),
        "{recovery}"
    );
}

#[test]
fn a_record_that_is_being_written_is_refused() {
    let case = Case::new();
    let mut recorder = Recorder::create(&case.output(), &common::meta()).unwrap();
    recorder.write(&common::log(0)).unwrap();
    recorder.flush().unwrap();
    let other = case.folder.path().join("other.mcap");
    let refused = recover(&case.input(), &other, |_, _| {}).unwrap_err();
    assert!(matches!(refused, RecordError::Busy(_)), "{refused}");
    assert!(!other.exists());
    drop(recorder);
    recover(&case.input(), &other, |_, _| {}).unwrap();
}

#[test]
fn a_record_without_the_descriptions_of_its_topics_is_saved() {
    const CHUNK: u8 = 6;
    let case = Case::new();
    let (mut bytes, _) = unfinished();
    let first = parts(&bytes)
        .into_iter()
        .find(|at| bytes[*at] == CHUNK)
        .unwrap();
    let content = first + 9;
    bytes[content + 100] ^= 1;
    let (recovery, entries) = case.recover(&bytes).unwrap();
    assert_eq!(entries, logs(0..FLUSHES));
    assert_eq!(recovery.damaged_places, 1);
    assert_eq!(recovery.missing, 0);
}
