//! The messages of a bag that a section of the map is about.

use super::invalid;

/// The messages of a section; without a topic if the map is one for CSV files.
#[derive(Clone, Copy, Debug)]
pub(in crate::import) struct Messages<'a> {
    /// The section, such as `pose`.
    pub(in crate::import) section: &'static str,
    topic: Option<&'a str>,
    stamp: Option<&'a str>,
}

/// The time of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::import) enum Stamp<'a> {
    /// When it was received, as the bag has it.
    Receive,
    /// A field of the message.
    Field(&'a str),
}

impl<'a> Messages<'a> {
    pub(super) fn new(
        section: &'static str,
        topic: &'a Option<String>,
        stamp: &'a Option<String>,
    ) -> Self {
        Self {
            section,
            topic: topic.as_deref(),
            stamp: stamp.as_deref(),
        }
    }

    /// The topic; the map is checked before to have one.
    pub(in crate::import) fn topic(self) -> &'a str {
        self.topic.unwrap_or_default()
    }

    pub(in crate::import) fn stamp(self) -> Stamp<'a> {
        match self.stamp {
            Some("receive") => Stamp::Receive,
            Some(field) => Stamp::Field(field),
            None => Stamp::Field("header.stamp"),
        }
    }

    pub(super) fn check(self, is_bag: bool) -> Result<(), String> {
        let [topic_key, stamp_key] =
            ["topic", "stamp"].map(|key| format!("{}.{key}", self.section));
        let csv = "remove it: a CSV file has no topics";
        match (self.topic, self.stamp) {
            (None, _) if is_bag => {
                let fix = "name the topic whose messages have the fields of this section";
                Err(invalid(&topic_key, "missing", fix))
            }
            (Some(topic), _) if !is_bag => Err(invalid(&topic_key, format!("{topic:?}"), csv)),
            (_, Some(stamp)) if !is_bag => Err(invalid(&stamp_key, format!("{stamp:?}"), csv)),
            _ => Ok(()),
        }
    }
}
