//! Makes bags: the messages by an encoder that is not the importer's, the files by the libraries of
//! their formats.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    io::Cursor,
    path::{Path, PathBuf},
};

use byteorder::{BigEndian, LittleEndian};
use mcap::records::MessageHeader;
use rusqlite::{Connection, params};
use serde::Serialize;
use singletrack_logs::import::{ImportError, import};
use tempfile::TempDir;

use crate::bench::{Imported, read};

/// The time of the first message of the tests, s since 1970.
pub(super) const START_S: i32 = 1_700_000_000;

/// How a bag is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storage {
    /// With definitions, and with chunks that are compressed.
    Mcap,
    /// The file of ROS 2 since Iron, with definitions.
    Sqlite,
    /// The file of ROS 2 before, without definitions.
    OldSqlite,
}

pub(super) const STORAGES: [Storage; 3] = [Storage::Mcap, Storage::Sqlite, Storage::OldSqlite];

/// A message on a topic.
#[derive(Clone, Debug)]
pub(super) struct Sent {
    pub(super) topic: &'static str,
    pub(super) receive_ns: u64,
    pub(super) bytes: Vec<u8>,
}

/// The contents of a bag.
#[derive(Clone, Debug, Default)]
pub(super) struct Bag {
    /// Topics with their types.
    pub(super) topics: Vec<(&'static str, &'static str)>,
    /// Definitions of types, in the order in which a bag has them.
    pub(super) definitions: BTreeMap<&'static str, String>,
    pub(super) messages: Vec<Sent>,
    /// The language of the definitions; `ros2msg` if it is empty.
    pub(super) language: &'static str,
    /// Whether the messages are stored as they were sent, whatever the time of their reception.
    pub(super) keeps_order: bool,
}

/// A stamp, as `builtin_interfaces/Time` has it.
pub(super) fn stamp(time_ns: u64) -> (i32, u32) {
    (
        i32::try_from(time_ns / 1_000_000_000).unwrap(),
        u32::try_from(time_ns % 1_000_000_000).unwrap(),
    )
}

/// A `std_msgs/Header`.
pub(super) fn header(time_ns: u64) -> ((i32, u32), &'static str) {
    (stamp(time_ns), "map")
}

/// A quaternion of this yaw.
pub(super) fn quaternion(yaw: f64) -> [f64; 4] {
    [0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()]
}

/// ns since 1970 of a time after the start.
pub(super) fn at(time_s: f64) -> u64 {
    let since_ns = (time_s * 1e9).round() as i64;
    (i64::from(START_S) * 1_000_000_000 + since_ns) as u64
}

/// A message as ROS 2 encodes it.
pub(super) fn encoded(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend(cdr_encoding::to_vec::<_, LittleEndian>(message).unwrap());
    bytes
}

/// A message as a computer with the other byte order encodes it.
pub(super) fn encoded_big(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![0, 0, 0, 0];
    bytes.extend(cdr_encoding::to_vec::<_, BigEndian>(message).unwrap());
    bytes
}

impl Bag {
    /// With topics of these types.
    pub(super) fn new(topics: &[(&'static str, &'static str)]) -> Self {
        Self {
            topics: topics.to_vec(),
            ..Self::default()
        }
    }

    /// Adds a message that arrives 2 ms after `time_s`.
    pub(super) fn send(&mut self, topic: &'static str, time_s: f64, message: &impl Serialize) {
        self.messages.push(Sent {
            topic,
            receive_ns: at(time_s) + 2_000_000,
            bytes: encoded(message),
        });
    }

    const fn language(&self) -> &'static str {
        if self.language.is_empty() {
            "ros2msg"
        } else {
            self.language
        }
    }

    fn definition(&self, kind: &str) -> &str {
        self.definitions.get(kind).map_or("", String::as_str)
    }

    /// Messages in the order of their reception.
    fn in_order(&self) -> Vec<&Sent> {
        let mut messages: Vec<_> = self.messages.iter().collect();
        if !self.keeps_order {
            messages.sort_by_key(|sent| sent.receive_ns);
        }
        messages
    }

    /// The bytes of an MCAP file.
    pub(super) fn mcap(&self) -> Vec<u8> {
        self.mcap_with(mcap::WriteOptions::new().chunk_size(Some(4096)))
    }

    /// The bytes of an MCAP file without chunks, and so without compression and checksums.
    pub(super) fn bare_mcap(&self) -> Vec<u8> {
        self.mcap_with(mcap::WriteOptions::new().use_chunks(false))
    }

    fn mcap_with(&self, options: mcap::WriteOptions) -> Vec<u8> {
        let options = options.profile("ros2");
        let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
        let mut channels = BTreeMap::new();
        for (topic, kind) in &self.topics {
            let definition = self.definition(kind).as_bytes();
            let schema = writer
                .add_schema(kind, self.language(), definition)
                .unwrap();
            let id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new());
            channels.insert(*topic, id.unwrap());
        }
        for (sequence, sent) in (0..).zip(self.in_order()) {
            let header = MessageHeader {
                channel_id: channels[sent.topic],
                sequence,
                log_time: sent.receive_ns,
                publish_time: sent.receive_ns,
            };
            writer.write_to_known_channel(&header, &sent.bytes).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    /// Writes a sqlite file, with definitions if `is_new`.
    pub(super) fn write_sqlite(&self, path: &Path, is_new: bool) {
        let connection = Connection::open(path).unwrap();
        let hash = if is_new {
            ", type_description_hash TEXT NOT NULL"
        } else {
            ""
        };
        let mut tables = format!(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
             CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
                 metadata TEXT NOT NULL);
             CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                 serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL{hash});
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                 timestamp INTEGER NOT NULL, data BLOB NOT NULL);
             CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        );
        if is_new {
            tables.push_str(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
                 encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,
                 type_description_hash TEXT NOT NULL);",
            );
        }
        connection.execute_batch(&tables).unwrap();
        for (id, (topic, kind)) in (1..).zip(&self.topics) {
            let hash = if is_new { ", ''" } else { "" };
            let query = format!("INSERT INTO topics VALUES (?, ?, ?, 'cdr', ''{hash})");
            connection
                .execute(&query, params![id, topic, kind])
                .unwrap();
            if is_new {
                let query = "INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')";
                let definition = self.definition(kind);
                connection
                    .execute(query, params![id, kind, self.language(), definition])
                    .unwrap();
            }
        }
        let query = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)";
        connection.execute_batch("BEGIN").unwrap();
        for sent in self.in_order() {
            let topic = self
                .topics
                .iter()
                .position(|(topic, _)| *topic == sent.topic);
            let (id, time) = (topic.unwrap() as i64 + 1, sent.receive_ns as i64);
            connection
                .execute(query, params![id, time, sent.bytes])
                .unwrap();
        }
        connection.execute_batch("COMMIT").unwrap();
    }
}

/// A folder for bags, with a map.
pub(super) struct Folder(TempDir);

impl Folder {
    pub(super) fn new(map: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("map.toml"), map).unwrap();
        Self(folder)
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a bag as a folder of one file for each part, and returns the folder.
    pub(super) fn write(&self, parts: &[Bag], storage: Storage) -> PathBuf {
        let folder = self.path("bag");
        fs::create_dir(&folder).unwrap();
        let mut metadata = "rosbag2_bagfile_information:\n  version: 9\n".to_owned();
        metadata.push_str("  compression_format: \"\"\n  compression_mode: \"\"\n");
        metadata.push_str("  relative_file_paths:\n");
        for (number, part) in parts.iter().enumerate() {
            let extension = match storage {
                Storage::Mcap => "mcap",
                Storage::Sqlite | Storage::OldSqlite => "db3",
            };
            let name = format!("bag_{number}.{extension}");
            writeln!(metadata, "    - {name}").unwrap();
            let file = folder.join(name);
            match storage {
                Storage::Mcap => fs::write(file, part.mcap()).unwrap(),
                _ => part.write_sqlite(&file, storage == Storage::Sqlite),
            }
        }
        metadata.push_str("  files:\n    - path: bag_0\n");
        fs::write(folder.join("metadata.yaml"), metadata).unwrap();
        folder
    }

    pub(super) fn import(&self, log: &Path) -> Result<Imported, ImportError> {
        let out = self.path("out.mcap");
        let summary = import(&[log], &self.path("map.toml"), &out, |_, _| {})?;
        Ok(read(&out, summary))
    }

    /// The message of an import that fails and leaves nothing, without the folder's name.
    pub(super) fn error(&self, log: &Path) -> String {
        let error = match self.import(log) {
            Ok(imported) => panic!("{}", imported.summary),
            Err(error) => error.to_string(),
        };
        assert!(!self.path("out.mcap").exists(), "{error}");
        error.replace(&format!("{}/", self.0.path().display()), "")
    }
}

/// Imports a bag of one part.
pub(super) fn imported(bag: &Bag, map: &str, storage: Storage) -> Imported {
    let folder = Folder::new(map);
    let log = folder.write(std::slice::from_ref(bag), storage);
    match folder.import(&log) {
        Ok(imported) => imported,
        Err(error) => panic!("{storage:?}: {error}"),
    }
}
