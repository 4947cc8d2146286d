//! The kinds of entries. Each has its own channel and message in the file, and lines of JSON, which
//! the daemon sends to its watchers.

#[cfg(test)]
pub(crate) mod tests;

use std::str::FromStr;

use singletrack_mocap::PoseState;

use crate::{
    Entry, StandardTopic, Value,
    message::{
        self, ConfigurationMessage, DropsMessage, Fields, LogMessage, PoseMessage, Represents,
        StatusMessage, TelemetryMessage, TickMessage, schema_name, schema_text,
    },
    value::{Json, Paths, Values},
};

/// Gives the list of topics to the macro `$then`, after its own arguments: the variant
/// of [`Topic`] and [`Entry`], its message, its name, and the field with the time at
/// which the entry reached the host.
macro_rules! topics {
    ($then:ident $($arguments:tt)*) => {
        $then! {
            [$($arguments)*]
            /// [`Entry::Tick`].
            Tick: TickMessage = "tick" at start_ns,
            /// [`Entry::Telemetry`].
            Telemetry: TelemetryMessage = "telemetry" at receive_time_ns,
            /// [`Entry::Status`].
            Status: StatusMessage = "status" at receive_time_ns,
            /// [`Entry::Pose`].
            Pose: PoseMessage = "pose" at receive_time_ns,
            /// [`Entry::Log`].
            Log: LogMessage = "log" at time_ns,
            /// [`Entry::Configuration`].
            Configuration: ConfigurationMessage = "configuration" at time_ns,
            /// [`Entry::Drops`].
            Drops: DropsMessage = "drops" at time_ns,
        }
    };
}

macro_rules! declare {
    ([]
        $(
            #[doc = $about:literal]
            $topic:ident: $message:ident = $name:literal at $time:ident,
        )*
    ) => {
        singletrack_control::words! {
            /// A kind of [`Entry`]. Its word is its name, on the command line and in JSON.
            #[derive(Hash)]
            pub enum Topic {
                $(#[doc = $about] $topic = $name,)*
            }
        }

        impl Topic {
            /// Its channel in the file, named as ROS names topics.
            pub const fn channel(self) -> &'static str {
                match self {
                    $(Self::$topic => concat!("/singletrack/", $name),)*
                }
            }
        }

        impl Entry {
            /// Its topic.
            pub const fn topic(&self) -> Topic {
                match self {
                    $(Self::$topic(_) => Topic::$topic,)*
                }
            }

            /// When it reached the host, in nanoseconds of the monotonic clock.
            pub const fn time_ns(&self) -> u64 {
                match self {
                    $(Self::$topic(entry) => entry.$time,)*
                }
            }
        }
    };
}

topics!(declare);

macro_rules! match_topic {
    (
        [$value:expr, $message:ident of $entry:ident => $result:expr]
        $(#[$about:meta] $topic:ident: $type:ident = $name:literal at $time:ident,)*
    ) => {
        match $value {
            $(Topic::$topic => {
                #[allow(unused_imports, reason = "not every expression makes an entry")]
                use crate::Entry::$topic as $entry;
                type $message = $type;
                $result
            })*
        }
    };
}

/// Evaluates an expression with `$message` as the message type of the topic and
/// `$entry` as its variant of [`Entry`].
macro_rules! with_message {
    ($topic:expr, $message:ident => $result:expr) => {
        with_message!($topic, $message of _Variant => $result)
    };
    ($topic:expr, $message:ident of $entry:ident => $result:expr) => {
        topics!(match_topic $topic, $message of $entry => $result)
    };
}

macro_rules! match_entry {
    (
        [$value:expr, $message:ident => $result:expr]
        $(#[$about:meta] $topic:ident: $type:ident = $name:literal at $time:ident,)*
    ) => {
        match $value {
            $(Entry::$topic(entry) => {
                let $message = $type::of(entry);
                $result
            })*
        }
    };
}

/// Evaluates an expression with `$message` as the entry's message.
macro_rules! with_entry {
    ($entry:expr, $message:ident => $result:expr) => {
        topics!(match_entry $entry, $message => $result)
    };
}

impl Topic {
    /// Its index among all topics.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The time of [`Entry::time_ns`] in one of its messages; none if it is no message of this topic.
    pub fn time_ns(self, message: &[u8]) -> Option<u64> {
        let entry = Entry::decode(self, message).ok()?;
        Some(entry.time_ns())
    }

    /// The name of its message, such as `singletrack_msgs/msg/Tick`.
    pub fn schema_name(self) -> String {
        with_message!(self, M => schema_name::<M>())
    }

    /// The definition of its message and of those within, as `ros2msg`.
    pub fn schema_text(self) -> String {
        with_message!(self, M => schema_text::<M>())
    }

    /// The paths of its fields, such as `estimate.yaw_rad`, in the order of
    /// [`Entry::values`].
    pub fn fields(self) -> Vec<String> {
        let mut paths = Paths::default();
        with_message!(self, M => M::absent().visit(&mut paths));
        paths.paths
    }
}

/// What reads messages from a file.
#[cfg(feature = "files")]
impl Topic {
    /// The topic with this channel, if there is one.
    pub(crate) fn of_channel(channel: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|topic| topic.channel() == channel)
    }

    /// Adds the fields of the message that `bytes` encode to `values`.
    pub(crate) fn read_values(self, bytes: &[u8], values: &mut Vec<Value>) -> Result<(), String> {
        let mut visitor = Values::new(values);
        with_message!(self, M => message::decode::<M>(bytes)?.visit(&mut visitor));
        Ok(())
    }

    /// The offset of the length of the list at the end of its messages; none if they end
    /// with no list. Everything before the list has the same length in all messages.
    pub(crate) fn list_at(self) -> Option<usize> {
        let mut bytes = Vec::new();
        match self {
            Self::Tick => message::encode(&TickMessage::absent(), &mut bytes).ok()?,
            _ => return None,
        }
        bytes.len().checked_sub(size_of::<u32>())
    }

    /// Adds the message that `bytes` encode to `json`, as [`Entry::write_json`] does.
    pub(crate) fn write_json(self, bytes: &[u8], json: &mut String) -> Result<(), String> {
        with_message!(self, M => {
            let message = message::decode::<M>(bytes)?;
            Json::entry(json, self.name(), |object| message.visit(object));
        });
        Ok(())
    }
}

/// There is no topic of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no topic {0:?}: use {known}", known = known())]
pub struct UnknownTopic(pub String);

/// The names of all topics, for a sentence.
fn known() -> String {
    let names = Topic::ALL.map(Topic::name);
    match names.split_last() {
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

impl FromStr for Topic {
    type Err = UnknownTopic;

    fn from_str(name: &str) -> Result<Self, UnknownTopic> {
        Self::named(name).ok_or_else(|| UnknownTopic(name.to_owned()))
    }
}

impl Entry {
    /// When the described event happened, in nanoseconds of the monotonic clock.
    pub const fn sample_time_ns(&self) -> u64 {
        match self {
            Self::Tick(tick) => tick.scheduled_ns,
            Self::Telemetry(record) => record.board_time_host_ns,
            Self::Pose(observation) => match observation.state {
                PoseState::Valid(pose) => pose.capture_time_ns,
                _ => observation.receive_time_ns,
            },
            Self::Status(_) | Self::Log(_) | Self::Configuration(_) | Self::Drops(_) => {
                self.time_ns()
            }
        }
    }

    /// Its fields, in the order of [`Topic::fields`]. The value of a list is its length.
    pub fn values(&self) -> Vec<Value> {
        let mut values = Vec::new();
        with_entry!(self, message => message.visit(&mut Values::new(&mut values)));
        values
    }

    /// Adds it to `json` as one object on one line, without a line end: `topic`, then the
    /// fields of its message. Times are integers beyond 2^53. An absent value and a
    /// quantity that is not finite are null.
    pub fn write_json(&self, json: &mut String) {
        with_entry!(self, message => {
            Json::entry(json, self.topic().name(), |object| message.visit(object));
        });
    }

    /// Adds its message, encoded, to `bytes`.
    pub(crate) fn encode(&self, bytes: &mut Vec<u8>) -> Result<(), cdr_encoding::Error> {
        with_entry!(self, message => message::encode(&message, bytes))
    }

    /// The entry that `bytes` encode: a message of the topic with its header.
    ///
    /// # Errors
    ///
    /// It is no message of this topic; in words.
    pub fn decode(topic: Topic, bytes: &[u8]) -> Result<Self, String> {
        with_message!(topic, M of Variant => {
            Ok(Variant(message::decode::<M>(bytes)?.value()?))
        })
    }
}

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
    pub const fn index(self) -> usize {
        match self {
            Self::Entry(topic) => topic.index(),
            Self::Standard(topic) => Topic::ALL.len() + topic as usize,
        }
    }

    /// Its name, such as `/singletrack/tick` or `/odom`.
    pub const fn topic(self) -> &'static str {
        match self {
            Self::Entry(topic) => topic.channel(),
            Self::Standard(topic) => topic.channel(),
        }
    }

    /// The name of its messages' type, such as `nav_msgs/msg/Odometry`.
    pub fn schema_name(self) -> String {
        match self {
            Self::Entry(topic) => topic.schema_name(),
            Self::Standard(topic) => topic.schema_name(),
        }
    }

    /// The definition of its messages' type, with all messages within it.
    pub fn schema_text(self) -> String {
        match self {
            Self::Entry(topic) => topic.schema_text(),
            Self::Standard(topic) => topic.schema_text(),
        }
    }
}

/// Adds one object to `json`, without a line end: the topic, then the fields by their
/// paths, such as `{"topic":"tick","estimate.yaw_rad":0.3}`.
pub fn write_json_object<'a>(
    json: &mut String,
    topic: &str,
    fields: impl IntoIterator<Item = (&'a str, &'a Value)>,
) {
    Json::entry(json, topic, |object| {
        for (path, value) in fields {
            object.put(path, value);
        }
    });
}
