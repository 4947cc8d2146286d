//! The values that a reader gives without an entry are those of the entry.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use proptest::prelude::*;
use singletrack_record::{Ending, Reader, Recorder, Topic, part_path};

use crate::common;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn messages_give_the_values_of_their_entries(
        entries in prop::collection::vec(common::entry(), 0..20),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        common::record(&path, &entries);
        let mut reader = Reader::open(&path).unwrap();
        let mut values = Vec::new();
        reader.read_values(&mut values).unwrap();
        prop_assert!(values.is_empty(), "there is no message yet");
        for entry in &entries {
            let message = reader.advance().unwrap().unwrap();
            prop_assert_eq!(message.topic, entry.topic());
            prop_assert_eq!(
                message.wall_ns,
                common::meta().start.wall_ns_at(entry.time_ns())
            );
            reader.read_values(&mut values).unwrap();
            // The text distinguishes -0.0 from 0.0 and makes NaN equal to itself.
            prop_assert_eq!(format!("{values:?}"), format!("{:?}", entry.values()));
            let (mut shown, mut expected) = (String::new(), String::new());
            reader.write_json(&mut shown).unwrap();
            entry.write_json(&mut expected);
            prop_assert_eq!(shown, expected);
        }
        prop_assert_eq!(reader.advance().unwrap(), None);
        prop_assert_eq!(reader.ending(), Some(Ending::Finished));
        prop_assert_eq!(reader.advance().unwrap(), None);
    }
}

#[test]
fn at_the_current_end_the_next_call_reads_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let mut recorder = Recorder::create(&path, &common::meta()).unwrap();
    recorder.write(&common::log(1)).unwrap();
    recorder.flush().unwrap();
    let mut reader = Reader::open(&part_path(&path)).unwrap();
    assert_eq!(reader.advance().unwrap().unwrap().topic, Topic::Log);
    for _ in 0..3 {
        assert_eq!(reader.advance().unwrap(), None);
        assert!(matches!(
            reader.ending(),
            Some(Ending::Unfinished { entries: 1, .. })
        ));
    }
    recorder.write(&common::log(2)).unwrap();
    recorder.flush().unwrap();
    assert_eq!(reader.advance().unwrap().unwrap().topic, Topic::Log);
    assert_eq!(reader.ending(), None);
    recorder.finish().unwrap();
    assert_eq!(reader.advance().unwrap(), None);
    assert_eq!(reader.ending(), Some(Ending::Finished));
}

#[test]
fn a_finished_record_knows_its_times_and_one_cut_anywhere_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    common::record(&path, &[common::log(3), common::log(9)]);
    let mut reader = Reader::open(&path).unwrap();
    let span = reader.span_wall_ns().unwrap();
    let times = [(); 2].map(|()| reader.advance().unwrap().unwrap().wall_ns);
    assert_eq!(span, times);

    let bytes = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    for length in (0..bytes.len()).rev().take(400) {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        if let Ok(reader) = Reader::open(&cut) {
            assert_eq!(reader.span_wall_ns(), None, "{length} bytes");
        }
    }
}
