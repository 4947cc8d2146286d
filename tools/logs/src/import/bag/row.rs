//! Messages of a bag as rows.

use std::path::Path;

use super::{Seconds, wanted::Sources};
use crate::import::{
    log::ImportError,
    row::{self, Cell, Place, Row as _},
};

/// A message, as a source wants it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) source: usize,
    /// Its number in the topic, from 1.
    pub(super) number: u64,
    /// When it was received, in ns since 1970.
    pub(super) receive_ns: u64,
    /// Its time, in ns since 1970.
    pub(super) stamp_ns: u64,
    /// Its fields; `None` where an element of a list is not there.
    pub(super) values: Vec<Option<f64>>,
}

impl Entry {
    /// The topic of the message, in errors.
    pub(super) fn topic<'a>(&self, sources: &'a Sources) -> &'a str {
        let source = sources.sources.get(self.source);
        source.map_or("", |source| &source.topic)
    }

    /// An error in the message.
    pub(super) fn error(&self, path: &Path, sources: &Sources, why: &str) -> ImportError {
        message_error(path, self.topic(sources), self.number, self.receive_ns, why)
    }
}

/// An error in a message: in the bag at `path`, the one with this number in its topic, from 1, that
/// was received at this time in ns since 1970.
pub(super) fn message_error(
    path: &Path,
    topic: &str,
    number: u64,
    receive_ns: u64,
    why: &str,
) -> ImportError {
    let seconds = Seconds(receive_ns);
    let message = format!(", topic {topic:?}, message {number} (received at {seconds} s)");
    ImportError::file(path, message + why)
}

/// A row: a message with its values.
pub(super) struct Row<'a> {
    pub(super) path: &'a Path,
    pub(super) sources: &'a Sources,
    pub(super) entry: &'a Entry,
}

impl row::Row for Row<'_> {
    fn has(&self, place: Place) -> bool {
        place.source == self.entry.source
    }

    fn cell(&self, place: Place) -> Cell<'_> {
        let value = self.entry.values.get(place.index).copied().flatten();
        value.map_or(Cell::Empty, Cell::Number)
    }

    fn wrong(&self, place: Place, expected: &str) -> ImportError {
        let source = self.sources.sources.get(place.source);
        let field = source.and_then(|source| source.fields.get(place.index));
        let field = field.map_or("", |field| &field.text);
        let value = self.number(place).unwrap_or(f64::NAN);
        let why = format!(
            ", field {field:?}: {value} is not {expected}: leave the time of the message out of the bag \
             with `ros2 bag convert`"
        );
        self.entry.error(self.path, self.sources, &why)
    }
}
