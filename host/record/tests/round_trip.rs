//! A reader gives the entries that were recorded, and their values without an entry; the layouts of the
//! messages are frozen for each version of records.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use std::{collections::BTreeSet, fs, iter, path::Path};

use proptest::prelude::*;
use singletrack_record::{
    Channel, Drops, Encoder, Ending, Entry, RECORD_VERSION, Reader, RecordError, Recorder,
    RecorderThread, Topic, Value, feed, part_path,
};

use crate::common;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_entry_is_read_as_it_was_written(
        entries in prop::collection::vec(common::entry(), 0..40),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        common::record(&path, &entries);
        let mut reader = Reader::open(&path).unwrap();
        prop_assert_eq!(&reader.meta, &common::meta());
        let read: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
        prop_assert_eq!(reader.ending, Some(Ending::Finished));
        // The text distinguishes -0.0 from 0.0.
        prop_assert_eq!(format!("{read:?}"), format!("{entries:?}"));
    }

    #[test]
    fn json_and_values_show_the_same(entry in common::entry()) {
        let mut json = String::new();
        entry.write_json(&mut json);
        prop_assert!(!json.contains('\n'));
        let object: serde_json::Value = serde_json::from_str(&json).unwrap();
        prop_assert_eq!(&object["topic"], entry.topic().name());
        let fields = entry.topic().fields();
        let values = entry.values();
        prop_assert_eq!(fields.len(), values.len());
        for (field, value) in fields.iter().zip(values) {
            let shown = field.split('.').fold(&object, |part, name| &part[name]);
            match value {
                Value::Absent => prop_assert!(shown.is_null(), "{}", field),
                Value::Bool(value) => prop_assert_eq!(shown, value),
                Value::Unsigned(length) if shown.is_array() => {
                    prop_assert_eq!(shown.as_array().unwrap().len() as u64, length);
                }
                Value::Unsigned(value) => prop_assert_eq!(shown, value),
                Value::Signed(value) => prop_assert_eq!(shown, value),
                Value::Float(value) if value.is_finite() => {
                    prop_assert_eq!(Value::Float(value).to_string().parse(), Ok(value));
                }
                Value::Float(_) => prop_assert!(shown.is_null()),
                Value::Text(value) => prop_assert_eq!(shown, &*value),
            }
        }
    }
}

#[test]
fn the_messages_of_an_entry_are_in_one_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let entries: Vec<_> = (0..30_000).map(common::log).collect();
    common::record(&path, &entries);
    let bytes = fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.chunk_indexes.len() > 2, "long enough for several");
    for chunk in &summary.chunk_indexes {
        let messages = summary.stream_chunk(&bytes, chunk).unwrap().count();
        assert_eq!(messages % 2, 0, "each line is there twice");
    }
}

#[test]
fn the_file_gets_its_name_when_it_is_finished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let mut recorder = Recorder::create(&path, &common::meta()).unwrap();
    recorder.write(&common::log(1)).unwrap();
    assert!(!path.exists());
    assert!(part_path(&path).exists());
    let finished = recorder.finish().unwrap();
    assert_eq!(finished.entries, 1);
    assert_eq!(finished.bytes, fs::metadata(&path).unwrap().len());
    assert!(!part_path(&path).exists());
}

#[test]
fn a_record_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    common::record(&path, &[common::log(1)]);
    let error = Recorder::create(&path, &common::meta()).err().unwrap();
    assert!(matches!(&error, RecordError::Exists(existing) if *existing == path));

    let other = folder.path().join("other.mcap");
    drop(Recorder::create(&other, &common::meta()).unwrap());
    let error = Recorder::create(&other, &common::meta()).err().unwrap();
    assert!(
        error.to_string().contains("other.mcap.part exists already"),
        "{error}"
    );
}

#[test]
fn a_missing_folder_is_named_in_the_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nowhere").join("drive.mcap");
    let error = Recorder::create(&path, &common::meta()).err().unwrap();
    assert!(
        error.to_string().contains("nowhere/drive.mcap.part"),
        "{error}"
    );
}

#[test]
fn only_the_chosen_topics_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let drops = Entry::Drops(Drops {
        time_ns: 2,
        entries: 9,
    });
    common::record(&path, &[common::log(1), drops.clone(), common::log(3)]);
    let read: Vec<_> = Reader::open(&path)
        .unwrap()
        .only(&[Topic::Drops])
        .map(Result::unwrap)
        .collect();
    assert_eq!(read, [drops]);
}

#[test]
fn times_in_the_container_are_on_the_wall_and_do_not_step() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let start = common::meta().start;
    common::record(&path, &[common::log(start.monotonic_ns + 250)]);
    let bytes = fs::read(&path).unwrap();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let types = ["singletrack_msgs/msg/Log", "rcl_interfaces/msg/Log"];
    assert_eq!(messages.len(), types.len());
    for (message, name) in messages.iter().zip(types) {
        assert_eq!(message.log_time, start.wall_ns + 250);
        assert_eq!(message.channel.message_encoding, "cdr");
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(schema.name, name);
        assert_eq!(schema.encoding, "ros2msg");
    }
}

#[test]
fn the_file_holds_what_the_encoder_publishes_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let entries: Vec<_> = (0..9).map(common::log).collect();
    common::record(&path, &entries);
    let bytes = fs::read(&path).unwrap();
    let read = mcap::MessageStream::new(&bytes).unwrap().map(|message| {
        let message = message.unwrap();
        (
            message.channel.topic.clone(),
            (message.log_time, message.publish_time),
            message.data.into_owned(),
        )
    });
    let mut encoder = Encoder::new(common::meta().start);
    let mut published = Vec::new();
    for entry in &entries {
        published.extend(encoder.encode(entry).unwrap().map(|publication| {
            (
                publication.channel.topic().to_owned(),
                (publication.log_time_ns, publication.publish_time_ns),
                publication.bytes.to_vec(),
            )
        }));
    }
    assert_eq!(published.len(), 18);
    assert_eq!(read.collect::<Vec<_>>(), published);
}

#[test]
fn the_recorder_thread_writes_pushed_entries_and_counts_lost_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let (mut input, output) = feed(4);
    // The ring is not emptied yet.
    let pushed = (0..6).filter(|time| input.push(common::log(*time))).count();
    assert_eq!(pushed, 4);
    let recorder = Recorder::create(&path, &common::meta()).unwrap();
    let (sender, observed) = std::sync::mpsc::channel();
    let thread = RecorderThread::start(recorder, output, move |entry| {
        sender.send(entry.clone()).unwrap();
    })
    .unwrap();
    let finished = thread.finish().unwrap();
    let read: Vec<_> = Reader::open(&path).unwrap().map(Result::unwrap).collect();
    assert_eq!(finished.entries, 5);
    assert_eq!(read[..4], (0..4).map(common::log).collect::<Vec<_>>());
    assert_eq!(
        read[4],
        Entry::Drops(Drops {
            time_ns: 3,
            entries: 2
        })
    );
    assert_eq!(observed.into_iter().collect::<Vec<_>>(), read);
}

#[test]
fn a_record_that_is_removed_or_moved_ends_with_an_error_at_the_next_flush() {
    for is_moved in [false, true] {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("records");
        fs::create_dir(&folder).unwrap();
        let mut recorder = Recorder::create(&folder.join("drive.mcap"), &common::meta()).unwrap();
        recorder.write(&common::log(0)).unwrap();
        recorder.flush().unwrap();
        if is_moved {
            fs::rename(&folder, parent.path().join("elsewhere")).unwrap();
        } else {
            fs::remove_dir_all(&folder).unwrap();
        }
        recorder.write(&common::log(1)).unwrap();
        let error = recorder.flush().unwrap_err();
        assert!(matches!(error, RecordError::Gone(_)), "{error}");
    }
}

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
        prop_assert_eq!(reader.ending, Some(Ending::Finished));
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
            reader.ending,
            Some(Ending::Unfinished { entries: 1, .. })
        ));
    }
    recorder.write(&common::log(2)).unwrap();
    recorder.flush().unwrap();
    assert_eq!(reader.advance().unwrap().unwrap().topic, Topic::Log);
    assert_eq!(reader.ending, None);
    recorder.finish().unwrap();
    assert_eq!(reader.advance().unwrap(), None);
    assert_eq!(reader.ending, Some(Ending::Finished));
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

/// If this test fails, the change is wrong, or `RECORD_VERSION` has to rise and the files
/// have to be replaced. A word (a constant) may be added within a version: readers take records
/// that lack it. The layouts of the messages of ROS never change here.
#[test]
fn the_layouts_are_those_of_this_version_and_its_package_of_ros() {
    assert_eq!(RECORD_VERSION, 14);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("msg");
    let own = "singletrack_msgs/msg/";
    let mut package = BTreeSet::new();
    for channel in Channel::all() {
        let (name, text) = (channel.schema_name(), channel.schema_text());
        let within = format!("{}\nMSG: singletrack_msgs/", "=".repeat(80));
        // A package has one file for each message.
        let layouts: Vec<(String, &str)> = match name.strip_prefix(own) {
            None => vec![(name.replace("/msg/", "/"), &text)],
            Some(name) => {
                let mut parts = text.split(&within);
                let outer = (name, parts.next().unwrap());
                let inner = parts.map(|part| part.split_once('\n').unwrap());
                let named = iter::once(outer).chain(inner);
                named
                    .map(|(name, part)| (format!("{own}{name}"), part))
                    .collect()
            }
        };
        for (file, now) in layouts {
            let file = format!("{file}.msg");
            let shown = Path::new(env!("CARGO_TARGET_TMPDIR")).join(&file);
            fs::create_dir_all(shown.parent().unwrap()).unwrap();
            fs::write(&shown, now).unwrap();
            let frozen = fs::read_to_string(folder.join(&file)).unwrap_or_default();
            assert!(
                now == frozen,
                "the layout of {file} has changed; it is now as in {}",
                shown.display()
            );
            package.extend(file.strip_prefix(own).map(str::to_owned));
        }
    }
    let files = fs::read_dir(folder.join(own)).unwrap();
    let files: BTreeSet<_> = files.map(|file| file.unwrap().file_name()).collect();
    assert_eq!(files, package.iter().map(Into::into).collect());
    let manifest = fs::read_to_string(folder.join("singletrack_msgs/package.xml")).unwrap();
    assert!(manifest.contains(&format!("<version>{RECORD_VERSION}.0.0</version>")));
}
