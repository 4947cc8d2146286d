//! What a map wants of a bag: topics, and fields of their messages, which are its rows.

use std::{collections::BTreeSet, path};

use super::{
    cdr::{Fault, Value},
    path::{Element, Part, Path, Takes},
    seconds,
};
use crate::import::{
    columns::{self, Cell, Header, Place},
    log::ImportError,
    map::Messages,
};

/// Names of elements that are listed in an error, at most.
const MAX_NAMES: usize = 20;

/// The messages that a section of the map is about.
pub(super) struct Source {
    /// The section, such as `pose`.
    section: &'static str,
    pub(super) topic: String,
    /// The time of a message; when it was received, if it is no field.
    pub(super) stamp: Option<Wanted>,
    pub(super) fields: Vec<Wanted>,
}

/// A field that the map names.
pub(super) struct Wanted {
    /// The key of the map.
    pub(super) key: String,
    /// Its value.
    pub(super) text: String,
    pub(super) path: Path,
    pub(super) takes: Takes,
    /// Whether a message has had it.
    pub(super) is_found: bool,
    /// Elements of its list that messages without it have had.
    pub(super) names: BTreeSet<String>,
}

impl Source {
    fn new(messages: Messages<'_>) -> Result<Self, ImportError> {
        let stamp = messages.stamp().map(|field| {
            let key = format!("{}.stamp", messages.section);
            Wanted::new(key, field, Takes::Stamp)
        });
        Ok(Self {
            section: messages.section,
            topic: messages.topic().to_owned(),
            stamp: stamp.transpose()?,
            fields: Vec::new(),
        })
    }

    /// All that it takes of a message.
    pub(super) fn wanted(&self) -> impl Iterator<Item = &Wanted> {
        self.fields.iter().chain(&self.stamp)
    }

    /// The key of the topic in the map.
    pub(super) fn key(&self) -> String {
        format!("{}.topic", self.section)
    }
}

impl Wanted {
    pub(super) fn new(key: String, text: &str, takes: Takes) -> Result<Self, ImportError> {
        let path = Path::parse(text).ok_or_else(|| {
            ImportError::Invalid(format!(
                "{key} in the map is {text:?}: write a field as a.b, a[0].b or a[name=x].b"
            ))
        })?;
        Ok(Self {
            key,
            text: text.to_owned(),
            path,
            takes,
            is_found: false,
            names: BTreeSet::new(),
        })
    }

    /// What a message has of it; `None` if no element of a list has the name.
    pub(super) fn find<'a, 'd>(
        &mut self,
        message: &'a Value<'d>,
    ) -> Result<Option<&'a Value<'d>>, Fault> {
        let mut value = message;
        for Part { field, element } in &self.path.0 {
            value = value.field(field);
            let elements = value.parts();
            value = match element {
                None => value,
                Some(Element::Index(index)) => {
                    let missing = || Fault::Element(field.clone(), elements.len(), *index);
                    elements.get(*index as usize).ok_or_else(missing)?
                }
                Some(Element::Named { key, value: name }) => {
                    let is_named = |one: &&Value<'_>| one.field(key).text() == name;
                    let Some(named) = elements.iter().find(is_named) else {
                        for other in elements.iter().filter(|_| !self.is_found) {
                            if self.names.len() < MAX_NAMES {
                                self.names.insert(other.field(key).text().to_owned());
                            }
                        }
                        return Ok(None);
                    };
                    named
                }
            };
        }
        self.is_found = true;
        Ok(Some(value))
    }
}

/// The sources of a map; a place in their rows is that of a source and of one of its fields.
impl Header for Vec<Source> {
    fn find(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        field: &str,
    ) -> Result<Place, ImportError> {
        let takes = match key {
            "pose.yaw" => Takes::Yaw,
            _ => Takes::Number,
        };
        let wanted = Wanted::new(key.to_owned(), field, takes)?;
        let mut known = self.iter();
        let place = match known.position(|source| source.section == messages.section) {
            Some(place) => place,
            None => {
                self.push(Source::new(messages)?);
                self.len() - 1
            }
        };
        let fields = &mut self[place].fields;
        fields.push(wanted);
        Ok(Place {
            source: place,
            index: fields.len() - 1,
        })
    }
}

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
    pub(super) fn topic<'a>(&self, sources: &'a [Source]) -> &'a str {
        &sources[self.source].topic
    }

    /// An error in the message.
    pub(super) fn error(&self, path: &path::Path, sources: &[Source], why: &str) -> ImportError {
        message_error(path, self.topic(sources), self.number, self.receive_ns, why)
    }
}

/// An error in a message: in the bag at `path`, the one with this number in its topic, from 1, that
/// was received at this time in ns since 1970.
pub(super) fn message_error(
    path: &path::Path,
    topic: &str,
    number: u64,
    receive_ns: u64,
    why: &str,
) -> ImportError {
    let seconds = seconds(receive_ns);
    let message = format!(", topic {topic:?}, message {number} (received at {seconds} s)");
    ImportError::file(path, message + why)
}

/// A row: a message with its values.
pub(super) struct Row<'a> {
    pub(super) path: &'a path::Path,
    pub(super) sources: &'a [Source],
    pub(super) entry: &'a Entry,
}

impl columns::Row for Row<'_> {
    fn has(&self, place: Place) -> bool {
        place.source == self.entry.source
    }

    fn cell(&self, place: Place) -> Cell<'_> {
        let value = self.entry.values.get(place.index).copied().flatten();
        value.map_or(Cell::Empty, Cell::Number)
    }

    fn wrong(&self, place: Place, expected: &str) -> ImportError {
        let field = &self.sources[place.source].fields[place.index].text;
        let value = self.number(place).unwrap_or(f64::NAN);
        let why = format!(
            ", field {field:?}: {value} is not {expected}: leave the time of the message out of the bag \
             with `ros2 bag convert`"
        );
        self.entry.error(self.path, self.sources, &why)
    }
}
