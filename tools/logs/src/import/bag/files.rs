//! The files of a bag of ROS 2: rosbag2, in MCAP or sqlite files.

use std::{
    collections::{HashMap, hash_map::Entry},
    fmt::Write as _,
    fs::{self, File},
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use mcap::{
    McapError,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use rusqlite::{Connection, OpenFlags, Row, limits::Limit};
use singletrack_record::parse_record;

use super::{
    messages::{Messages, Topic},
    unreadable,
};
use crate::import::log::ImportError;

/// The list of files in the folder of a bag.
const METADATA: &str = "metadata.yaml";

/// How messages are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Storage {
    Mcap,
    Sqlite,
}

/// Whether a path is that of a bag, by its name: a folder, or a file of one.
pub(in crate::import) fn is_bag(path: &Path) -> bool {
    let is_file = ["mcap", "db3", "bag", "zstd", "zip"]
        .iter()
        .any(|extension| path.extension().is_some_and(|own| own == *extension));
    is_file || path.is_dir()
}

/// Refuses a file that is none of a bag, whatever the map.
pub(in crate::import) fn check(path: &Path) -> Result<(), ImportError> {
    match path.is_dir() {
        true => Ok(()),
        false => storage(path).map(drop),
    }
}

/// Reads the messages of a bag.
pub(super) fn read(path: &Path, messages: &mut Messages) -> Result<(), ImportError> {
    for (file, storage) in files(path)? {
        match storage {
            Storage::Mcap => read_mcap(&file, messages)?,
            Storage::Sqlite => read_sqlite(&file, messages)?,
        }
    }
    Ok(())
}

/// The files of a bag, in their order.
fn files(path: &Path) -> Result<Vec<(PathBuf, Storage)>, ImportError> {
    if !path.is_dir() {
        return Ok(vec![(path.to_owned(), storage(path)?)]);
    }
    let metadata = path.join(METADATA);
    let text = match fs::read_to_string(&metadata) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let files = readable_files(path).into_iter();
            let files: String = files.map(|file| format!(", {file}")).collect();
            let why = "it has no metadata.yaml: write it with `ros2 bag reindex`, or import one of its files";
            return Err(unreadable(path, format!("{why}{files}")));
        }
        Err(error) => return Err(ImportError::read(&metadata)(error)),
    };
    let names = names(&text).map_err(|why| unreadable(path, why))?;
    let file = |name: &String| {
        // Old bags have the name of the folder before that of the file.
        let name = Path::new(name).file_name().unwrap_or_default();
        let file = path.join(name);
        let storage = storage(&file)?;
        Ok((file, storage))
    };
    names.iter().map(file).collect()
}

/// The names of files in the list of a bag. It is YAML that a program writes, with one key or element
/// a line.
fn names(text: &str) -> Result<Vec<String>, String> {
    let unquoted = |word: &str| word.trim().trim_matches(['"', '\'']).to_owned();
    let mut names = Vec::new();
    let mut is_list = false;
    for line in text.lines().map(str::trim) {
        match line.strip_prefix("- ") {
            Some(name) if is_list => names.push(unquoted(name)),
            Some(_) => {}
            None => is_list = line == "relative_file_paths:",
        }
        if let Some(mode) = line.strip_prefix("compression_mode:")
            && !matches!(unquoted(mode).as_str(), "" | "NONE" | "none")
        {
            return Err(format!(
                "it is compressed ({} mode): convert it with `ros2 bag convert` to one without \
                 compression",
                unquoted(mode)
            ));
        }
    }
    match names.is_empty() {
        true => Err(
            "its metadata.yaml has no list relative_file_paths: write it with `ros2 bag reindex`"
                .to_owned(),
        ),
        false => Ok(names),
    }
}

fn storage(file: &Path) -> Result<Storage, ImportError> {
    let extension = file.extension().map(|own| own.to_string_lossy());
    let why = match extension.as_deref() {
        Some("mcap") => return Ok(Storage::Mcap),
        Some("db3") => return Ok(Storage::Sqlite),
        Some("zstd") => {
            "it is compressed: decompress it with `zstd -d`, and import the file that it makes"
        }
        Some("zip") => {
            "it is an archive: unpack it with `unzip`, and import the bag's folder in it"
        }
        Some("bag") => "it is a bag of ROS 1: convert it with `rosbags-convert`",
        _ => "its name ends neither in .mcap nor in .db3",
    };
    Err(unreadable(file, why))
}

/// The files in a folder that can be imported, in the order of their names.
fn readable_files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let files = entries.filter(|entry| storage(&entry.path()).is_ok());
    let mut names: Vec<_> = files
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The length of a record that every file may have, in bytes.
const LONGEST: usize = 64 << 20;

/// Reads an MCAP file.
fn read_mcap(path: &Path, messages: &mut Messages) -> Result<(), ImportError> {
    let failed = ImportError::read(path);
    let damaged = |error: McapError| unreadable(path, fix(&error));
    let mut file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    // A record that claims to be longer is an error, before there is memory for it. Those of a
    // compressed chunk may be longer than the file.
    let options = LinearReaderOptions::default()
        .with_record_length_limit(usize::try_from(length).unwrap_or(usize::MAX).max(LONGEST))
        .with_validate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut schemas = HashMap::new();
    let mut channels = HashMap::new();
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event.map_err(damaged)? {
            LinearReadEvent::Record { opcode, data } => (opcode, data),
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need)).map_err(failed)?;
                reader.notify_read(read);
                continue;
            }
        };
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            continue;
        }
        match parse_record(opcode, data).map_err(damaged)? {
            Record::Schema { header, data } => {
                let text = String::from_utf8_lossy(&data).into_owned();
                schemas.insert(header.id, (header, text));
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id);
                let topic = Topic {
                    name: &channel.topic,
                    kind: schema.map_or("", |(header, _)| &header.name),
                    encoding: &channel.message_encoding,
                    definition: schema.map(|(header, text)| (&*header.encoding, &**text)),
                };
                if let Entry::Vacant(new) = channels.entry(channel.id) {
                    new.insert(messages.topic(&topic)?);
                }
            }
            Record::Message { header, data } => {
                let channel = header.channel_id;
                let unknown = || damaged(McapError::UnknownChannel(0, channel));
                if let Some(id) = channels.get(&channel).ok_or_else(unknown)? {
                    messages.message(*id, header.log_time, &data)?;
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// What is wrong with an MCAP file, and what to do.
fn fix(error: &McapError) -> String {
    let fix = match error {
        McapError::UnsupportedCompression(_) => {
            "only zstd is read: `mcap compress --compression zstd` and `ros2 bag convert` make such a file"
        }
        McapError::BadMagic => {
            "it is no MCAP file, or its end is missing: `mcap recover` repairs it"
        }
        _ => "it is damaged: `mcap recover` saves what can be read",
    };
    format!("{error}: {fix}")
}

/// Reads an sqlite file.
fn read_sqlite(path: &Path, messages: &mut Messages) -> Result<(), ImportError> {
    let metadata = fs::metadata(path).map_err(ImportError::read(path))?;
    let damaged = |why: String| unreadable(path, why);
    let failed =
        |error: rusqlite::Error| damaged(format!("{error}: it is damaged, or no sqlite file"));
    // Of a bag that is still written, or was not closed, the newest messages are in a file beside it.
    let beside = |end: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(end);
        PathBuf::from(name)
    };
    let has_shared = beside("-shm").exists();
    let is_filled = |end: &str| fs::metadata(beside(end)).is_ok_and(|file| file.len() > 0);
    if is_filled("-wal") && !has_shared {
        return Err(damaged(format!(
            "its recorder has not closed it: `sqlite3 {} 'PRAGMA wal_checkpoint(TRUNCATE)'` takes the \
             messages of {} into it",
            path.display(),
            beside("-wal").display()
        )));
    }
    let is_closed = !has_shared && !is_filled("-journal");
    let connection = open(path, metadata.len(), is_closed).map_err(failed)?;
    // Views and virtual tables, which run code, are none.
    let query = "SELECT name FROM sqlite_schema WHERE type = 'table' AND rootpage > 0";
    let tables: Vec<String> = all(&connection, query, |row| row.get(0)).map_err(failed)?;
    let has = |name: &str| tables.iter().any(|table| table == name);
    if !has("topics") || !has("messages") {
        let why = "it has no tables `topics` and `messages`: it is no bag of ROS 2";
        return Err(damaged(why.to_owned()));
    }
    // Language and text of the definition of each type.
    let query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
    let row = |row: &Row<'_>| Ok((row.get(0)?, [row.get(1)?, row.get(2)?]));
    let definitions: HashMap<String, [String; 2]> = match has("message_definitions") {
        true => all(&connection, query, row).map_err(failed)?,
        false => HashMap::new(),
    };
    let query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id";
    let row = |row: &Row<'_>| Ok((row.get(0)?, [row.get(1)?, row.get(2)?, row.get(3)?]));
    let topics: Vec<(i64, [String; 3])> = all(&connection, query, row).map_err(failed)?;
    let mut ids = HashMap::new();
    for (id, [name, kind, encoding]) in topics {
        let definition = definitions.get(&kind);
        let topic = Topic {
            name: &name,
            kind: &kind,
            encoding: &encoding,
            definition: definition.map(|[language, text]| (language.as_str(), text.as_str())),
        };
        ids.insert(id, messages.topic(&topic)?);
    }
    let query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id";
    let mut statement = connection.prepare(query).map_err(failed)?;
    let mut rows = statement.query([]).map_err(failed)?;
    while let Some(row) = rows.next().map_err(failed)? {
        let topic: i64 = row.get(0).map_err(failed)?;
        let unknown = || {
            damaged(format!(
                "a message is of topic {topic}, which is not described"
            ))
        };
        let id = ids.get(&topic).ok_or_else(unknown)?;
        if let Some(id) = id {
            let ns: i64 = row.get(1).map_err(failed)?;
            let early = |_| damaged(format!("a message was received at {ns} ns, before 1970"));
            let receive_ns = u64::try_from(ns).map_err(early)?;
            let data = row.get_ref(2).map_err(failed)?;
            let data = data.as_blob().map_err(|error| failed(error.into()))?;
            messages.message(*id, receive_ns, data)?;
        }
    }
    Ok(())
}

/// Opens a file to read it, such that it can't have code that runs, or values longer than itself. A
/// closed one is as it is: else sqlite would make files for writers beside it, and leave them there.
fn open(path: &Path, length: u64, is_closed: bool) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = if is_closed {
        let flags = flags | OpenFlags::SQLITE_OPEN_URI;
        Connection::open_with_flags(format!("file:{}?immutable=1", escaped(path)), flags)?
    } else {
        Connection::open_with_flags(path, flags)?
    };
    let longest = i32::try_from(length).unwrap_or(i32::MAX);
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, longest.max(4096))?;
    connection.pragma_update(None, "trusted_schema", false)?;
    connection.pragma_update(None, "cell_size_check", true)?;
    Ok(connection)
}

/// A path as a URI has it.
fn escaped(path: &Path) -> String {
    let mut text = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                text.push(char::from(*byte));
            }
            // Writing to a string does not fail.
            _ => drop(write!(text, "%{byte:02X}")),
        }
    }
    text
}

/// All rows of a query.
fn all<T, All: FromIterator<T>>(
    connection: &Connection,
    query: &str,
    row: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
) -> rusqlite::Result<All> {
    connection.prepare(query)?.query_map([], row)?.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_of_files_is_read_with_and_without_quotes() {
        let text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - \
                bag/a_0.db3\n    - \"a 1.db3\"\n  topics_with_message_count:\n    - topic_metadata:\n  \
                compression_format: \"\"\n  compression_mode: \"\"\n";
        let expected = ["bag/a_0.db3", "a 1.db3"].map(str::to_owned);
        assert_eq!(names(text), Ok(expected.to_vec()));
        let compressed = text.replace("compression_mode: \"\"", "compression_mode: FILE");
        let error = names(&compressed).unwrap_err();
        assert!(error.contains("compressed (FILE mode)"), "{error}");
        // The file that `rosbags-convert` writes.
        let text = "rosbag2_bagfile_information:\n  compression_mode: ''\n  files:\n  - duration:\n      \
                nanoseconds: 2\n    path: log.db3\n  relative_file_paths:\n  - log.db3\n  ros_distro: \
                rosbags\n";
        assert_eq!(names(text), Ok(vec!["log.db3".to_owned()]));
        assert!(names("rosbag2_bagfile_information:\n").is_err());
    }
}
