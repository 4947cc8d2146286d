//! Why a bag can't be imported.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// A bag that can't be imported.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// A file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file or a folder is no bag, or is damaged.
    #[error("can't read {} as a bag: {why}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why, and what to do.
        why: String,
    },
    /// The map has something else than a field.
    #[error("{key} in the map is {field:?}: write a field as a.b, a[0].b or a[name=x].b")]
    Path {
        /// The key of the map.
        key: String,
        /// Its value.
        field: String,
    },
    /// The bag does not have a topic.
    #[error("{} has {what} {topic:?}, which {key} in the map names; its topics are {topics}", path.display())]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// What it lacks.
        what: &'static str,
        /// The topic.
        topic: String,
        /// The key of the map.
        key: String,
        /// Those that the bag has, with their types.
        topics: String,
    },
    /// A topic has a type that can't be read, or not the fields of the map.
    #[error("{}, topic {topic:?} of type {kind}: {why}", path.display())]
    Topic {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its type.
        kind: String,
        /// Why, and what to do.
        why: String,
    },
    /// A message can't be decoded, or has a value or a time that can't be right.
    #[error("{message}{why}")]
    Message {
        /// The message.
        message: Message,
        /// Why, and what to do.
        why: String,
    },
}

impl BagError {
    /// Of a file that is no bag, or is damaged.
    pub(super) fn file(path: &Path, why: impl Into<String>) -> Self {
        Self::File {
            path: path.to_owned(),
            why: why.into(),
        }
    }
}

/// A message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The bag.
    pub path: PathBuf,
    /// The topic.
    pub topic: String,
    /// Its number in the topic, from 1.
    pub number: u64,
    /// When it was received, in ns since 1970.
    pub receive_ns: u64,
}

impl fmt::Display for Message {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            path,
            topic,
            number,
            receive_ns,
        } = self;
        let (path, seconds) = (path.display(), Seconds(*receive_ns));
        write!(
            formatter,
            "{path}, topic {topic:?}, message {number} (received at {seconds} s)"
        )
    }
}

/// A time in ns, written in seconds with all digits.
pub(super) struct Seconds(pub(super) u64);

impl fmt::Display for Seconds {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(ns) = self;
        let (seconds, rest) = (ns / 1_000_000_000, ns % 1_000_000_000);
        write!(formatter, "{seconds}.{rest:09}")
    }
}
