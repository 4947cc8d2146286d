//! Bags in sqlite files.

use std::{
    collections::HashMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use rusqlite::{Connection, OpenFlags, Row, limits::Limit};

use super::{
    messages::{Messages, Topic},
    unreadable,
};
use crate::import::log::ImportError;

/// Reads a file.
pub(super) fn read(path: &Path, messages: &mut Messages) -> Result<(), ImportError> {
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
