//! What a map wants of a bag: topics, and fields of their messages.

use std::collections::BTreeSet;

use super::path::{Path, Takes};
use crate::import::{
    log::ImportError,
    map::{Messages, Stamp},
    row::{Header, Place},
};

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

/// The sources of a map; a place in their rows is that of a source and of one of its fields.
#[derive(Default)]
pub(super) struct Sources {
    pub(super) sources: Vec<Source>,
}

impl Source {
    /// The key of the topic in the map.
    pub(super) fn key(&self) -> String {
        format!("{}.topic", self.section)
    }
}

impl Wanted {
    fn new(key: String, text: &str, takes: Takes) -> Result<Self, ImportError> {
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
}

impl Sources {
    /// The place of the source of a section.
    fn source(&mut self, messages: Messages<'_>) -> Result<usize, ImportError> {
        let section = messages.section;
        let mut known = self.sources.iter();
        if let Some(place) = known.position(|source| source.section == section) {
            return Ok(place);
        }
        let topic = messages.topic().to_owned();
        let stamp = match messages.stamp() {
            Stamp::Receive => None,
            Stamp::Field(field) => {
                let key = format!("{section}.stamp");
                Some(Wanted::new(key, field, Takes::Stamp)?)
            }
        };
        self.sources.push(Source {
            section,
            topic,
            stamp,
            fields: Vec::new(),
        });
        Ok(self.sources.len() - 1)
    }
}

impl Header for Sources {
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
        let place = self.source(messages)?;
        let mut index = 0;
        if let Some(source) = self.sources.get_mut(place) {
            index = source.fields.len();
            source.fields.push(wanted);
        }
        Ok(Place {
            source: place,
            index,
        })
    }
}
