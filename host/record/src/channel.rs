//! The channels of a record: topics, each with messages of one type.

use crate::{StandardTopic, Topic};

/// A topic in the file or in a live view, and the type of its messages.
///
/// Every message of an [`crate::Encoder`] is on one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// The entries of one topic, complete and exact.
    Entry(Topic),
    /// Messages of a standard type, derived from the entries.
    Standard(StandardTopic),
}

impl Channel {
    /// The number of channels.
    pub const COUNT: usize = Topic::ALL.len() + StandardTopic::ALL.len();
    /// MCAP's name for the encoding of the messages.
    pub const MESSAGE_ENCODING: &'static str = "cdr";
    /// MCAP's name for the language of the schemas.
    pub const SCHEMA_ENCODING: &'static str = "ros2msg";

    /// All channels, in the order of [`Channel::index`].
    pub fn all() -> impl Iterator<Item = Self> {
        let entries = Topic::ALL.into_iter().map(Self::Entry);
        entries.chain(StandardTopic::ALL.into_iter().map(Self::Standard))
    }

    /// Its index among all channels, less than [`Channel::COUNT`].
    #[must_use]
    pub const fn index(self) -> usize {
        match self {
            Self::Entry(topic) => topic.index(),
            Self::Standard(topic) => Topic::ALL.len() + topic as usize,
        }
    }

    /// Its name, such as `/singletrack/tick` or `/odom`.
    #[must_use]
    pub const fn topic(self) -> &'static str {
        match self {
            Self::Entry(topic) => topic.channel(),
            Self::Standard(topic) => topic.channel(),
        }
    }

    /// The name of its messages' type, such as `nav_msgs/msg/Odometry`.
    #[must_use]
    pub fn schema_name(self) -> String {
        match self {
            Self::Entry(topic) => topic.schema_name(),
            Self::Standard(topic) => topic.schema_name(),
        }
    }

    /// The definition of its messages' type, with all messages within it.
    #[must_use]
    pub fn schema_text(self) -> String {
        match self {
            Self::Entry(topic) => topic.schema_text(),
            Self::Standard(topic) => topic.schema_text(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_channel_is_at_its_index() {
        for (place, channel) in Channel::all().enumerate() {
            assert_eq!(channel.index(), place, "{}", channel.topic());
        }
        assert_eq!(Channel::all().count(), Channel::COUNT);
    }
}
