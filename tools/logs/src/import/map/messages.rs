//! The messages of a bag that a section of the map is about.

use super::invalid;

/// The key of a topic, and that of its time.
pub(super) type MessageKeys = [&'static str; 2];

/// The messages of a section; without a topic if the map is one for CSV files.
#[derive(Clone, Copy, Debug)]
pub(in crate::import) struct Messages<'a> {
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
    pub(super) fn new(topic: &'a Option<String>, stamp: &'a Option<String>) -> Self {
        Self {
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

    pub(super) fn check(
        self,
        [topic_key, stamp_key]: MessageKeys,
        is_bag: bool,
    ) -> Result<(), String> {
        let csv = "remove it: a CSV file has no topics";
        match (self.topic, self.stamp) {
            (None, _) if is_bag => {
                let fix = "name the topic whose messages have the fields of this section";
                Err(invalid(topic_key, "missing", fix))
            }
            (Some(topic), _) if !is_bag => Err(invalid(topic_key, format!("{topic:?}"), csv)),
            (_, Some(stamp)) if !is_bag => Err(invalid(stamp_key, format!("{stamp:?}"), csv)),
            _ => Ok(()),
        }
    }
}
