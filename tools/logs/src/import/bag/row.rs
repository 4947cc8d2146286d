//! Messages of a bag as rows.

use std::{borrow::Cow, path::Path};

use super::{
    error::{BagError, Message},
    wanted::Sources,
};
use crate::import::row::{self, Place};

/// A message, as a source wants it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) source: usize,
    /// Its number in the topic, from 1.
    pub(super) number: u64,
    /// When it was received, in ns since 1970.
    pub(super) receive_ns: u64,
    /// Its time, in ns since 1970.
    pub(super) stamp_ns: u64,
    /// The first one of its values.
    pub(super) values: usize,
}

impl Entry {
    /// The message, in errors.
    pub(super) fn message(&self, path: &Path, sources: &Sources) -> Message {
        let source = sources.sources.get(self.source);
        Message {
            path: path.to_owned(),
            topic: source.map_or_else(String::new, |source| source.topic.clone()),
            number: self.number,
            receive_ns: self.receive_ns,
        }
    }
}

/// A row: a message with its values.
pub(super) struct Row<'a> {
    pub(super) path: &'a Path,
    pub(super) sources: &'a Sources,
    pub(super) entry: Entry,
    /// Those of all messages; `None` where an element of a list is not there.
    pub(super) values: &'a [Option<f64>],
}

impl Row<'_> {
    fn value(&self, place: Place) -> Option<f64> {
        self.values
            .get(self.entry.values + place.index)
            .copied()
            .flatten()
    }

    fn error(&self, place: Place, value: f64, expected: &'static str) -> BagError {
        let source = self.sources.sources.get(place.source);
        let field = source.and_then(|source| source.fields.get(place.index));
        let field = field.map_or("", |field| &field.text);
        BagError::Message {
            message: self.entry.message(self.path, self.sources),
            why: format!(
                ", field {field:?}: {value} is not {expected}: leave the time of the message out of the bag \
                 with `ros2 bag convert`"
            ),
        }
    }
}

impl row::Row for Row<'_> {
    type Error = BagError;

    fn has(&self, place: Place) -> bool {
        place.source == self.entry.source
    }

    fn is_empty(&self, place: Place) -> bool {
        self.value(place).is_none()
    }

    fn text(&self, place: Place) -> Cow<'_, str> {
        let value = self.value(place).map(|value| value.to_string());
        Cow::Owned(value.unwrap_or_default())
    }

    fn number(&self, place: Place) -> Result<f64, BagError> {
        Ok(self.value(place).unwrap_or(f64::NAN))
    }

    fn finite(&self, place: Place) -> Result<f64, BagError> {
        let number = self.number(place)?;
        match number.is_finite() {
            true => Ok(number),
            false => Err(self.error(place, number, "a finite number")),
        }
    }

    fn flag(&self, place: Place) -> Result<bool, BagError> {
        let number = self.number(place)?;
        match number.is_nan() {
            false => Ok(number != 0.0),
            true => Err(self.error(place, number, "a number, true or false")),
        }
    }
}
