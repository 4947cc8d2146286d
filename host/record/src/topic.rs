//! The kinds of entries, each with its own channel and message in the file.

use std::{fmt, str::FromStr};

use byteorder::LittleEndian;
use serde::Serialize;
use singletrack_mocap::PoseState;

use crate::{
    Entry, Value,
    message::{
        ConfigurationMessage, DropsMessage, LogMessage, Message, PoseMessage, Senseless,
        StatusMessage, TelemetryMessage, TickMessage, schema_name, schema_text,
    },
    value::{Json, Paths, Values},
};

/// A kind of [`Entry`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Topic {
    /// [`Entry::Tick`].
    Tick,
    /// [`Entry::Telemetry`].
    Telemetry,
    /// [`Entry::Status`].
    Status,
    /// [`Entry::Pose`].
    Pose,
    /// [`Entry::Log`].
    Log,
    /// [`Entry::Configuration`].
    Configuration,
    /// [`Entry::Drops`].
    Drops,
}

/// Evaluates an expression with `$message` as the topic's message type.
macro_rules! with_message {
    ($topic:expr, $message:ident => $result:expr) => {
        match $topic {
            Topic::Tick => {
                type $message = TickMessage;
                $result
            }
            Topic::Telemetry => {
                type $message = TelemetryMessage;
                $result
            }
            Topic::Status => {
                type $message = StatusMessage;
                $result
            }
            Topic::Pose => {
                type $message = PoseMessage;
                $result
            }
            Topic::Log => {
                type $message = LogMessage;
                $result
            }
            Topic::Configuration => {
                type $message = ConfigurationMessage;
                $result
            }
            Topic::Drops => {
                type $message = DropsMessage;
                $result
            }
        }
    };
}

/// Evaluates an expression with `$message` as the entry's message.
macro_rules! with_entry {
    ($entry:expr, $message:ident => $result:expr) => {
        match $entry {
            Entry::Tick(entry) => {
                let $message = TickMessage::from(entry);
                $result
            }
            Entry::Telemetry(entry) => {
                let $message = TelemetryMessage::from(entry);
                $result
            }
            Entry::Status(entry) => {
                let $message = StatusMessage::from(entry);
                $result
            }
            Entry::Pose(entry) => {
                let $message = PoseMessage::from(entry);
                $result
            }
            Entry::Log(entry) => {
                let $message = LogMessage::from(entry);
                $result
            }
            Entry::Configuration(entry) => {
                let $message = ConfigurationMessage::from(entry);
                $result
            }
            Entry::Drops(entry) => {
                let $message = DropsMessage::from(entry);
                $result
            }
        }
    };
}

impl Topic {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Tick,
        Self::Telemetry,
        Self::Status,
        Self::Pose,
        Self::Log,
        Self::Configuration,
        Self::Drops,
    ];

    /// Its name, on the command line and in JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tick => "tick",
            Self::Telemetry => "telemetry",
            Self::Status => "status",
            Self::Pose => "pose",
            Self::Log => "log",
            Self::Configuration => "configuration",
            Self::Drops => "drops",
        }
    }

    /// Its channel in the file, named as ROS names topics.
    #[must_use]
    pub const fn channel(self) -> &'static str {
        match self {
            Self::Tick => "/singletrack/tick",
            Self::Telemetry => "/singletrack/telemetry",
            Self::Status => "/singletrack/status",
            Self::Pose => "/singletrack/pose",
            Self::Log => "/singletrack/log",
            Self::Configuration => "/singletrack/configuration",
            Self::Drops => "/singletrack/drops",
        }
    }

    /// The name of its message, such as `singletrack_msgs/msg/Tick`.
    #[must_use]
    pub fn schema_name(self) -> String {
        with_message!(self, M => schema_name::<M>())
    }

    /// The definition of its message and of those within, as `ros2msg`.
    #[must_use]
    pub fn schema_text(self) -> String {
        with_message!(self, M => schema_text::<M>())
    }

    /// The paths of its fields, in order: `estimate.yaw_rad`. Those of
    /// [`Entry::values`].
    #[must_use]
    pub fn fields(self) -> Vec<String> {
        let mut paths = Paths::default();
        with_message!(self, M => M::absent().visit(&mut paths));
        paths.paths
    }

    /// Adds the fields of the message that `bytes` encode to `values`.
    pub(crate) fn read_values(self, bytes: &[u8], values: &mut Vec<Value>) -> Result<(), String> {
        let mut visitor = Values::new(values);
        with_message!(self, M => message::<M>(bytes)?.visit(&mut visitor));
        Ok(())
    }

    /// Where its messages have the length of the list that they end with, if they
    /// do: all that comes before is as long in one as in the other.
    pub(crate) fn list_at(self) -> Option<usize> {
        let mut bytes = Vec::new();
        match self {
            Self::Tick => encode(&TickMessage::absent(), &mut bytes).ok()?,
            _ => return None,
        }
        bytes.len().checked_sub(size_of::<u32>())
    }

    /// Adds the message that `bytes` encode to `json`: [`Entry::write_json`].
    pub(crate) fn write_json(self, bytes: &[u8], json: &mut String) -> Result<(), String> {
        with_message!(self, M => {
            let message = message::<M>(bytes)?;
            Json::entry(json, self, |object| message.visit(object));
        });
        Ok(())
    }
}

impl fmt::Display for Topic {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// There is no topic of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no topic {0:?}: use tick, telemetry, status, pose, log, configuration or drops")]
pub struct UnknownTopic(pub String);

impl FromStr for Topic {
    type Err = UnknownTopic;

    fn from_str(name: &str) -> Result<Self, UnknownTopic> {
        Self::ALL
            .into_iter()
            .find(|topic| topic.name() == name)
            .ok_or_else(|| UnknownTopic(name.to_owned()))
    }
}

/// Plain CDR, little-endian, no options: what every ROS 2 message begins with.
const ENCAPSULATION: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

/// Adds a message to `bytes` as ROS 2 encodes it.
pub(crate) fn encode(
    message: &impl Serialize,
    bytes: &mut Vec<u8>,
) -> Result<(), cdr_encoding::Error> {
    bytes.extend_from_slice(&ENCAPSULATION);
    cdr_encoding::to_writer::<_, LittleEndian, _>(bytes, message)
}

impl Entry {
    /// What kind of entry it is.
    #[must_use]
    pub const fn topic(&self) -> Topic {
        match self {
            Self::Tick(_) => Topic::Tick,
            Self::Telemetry(_) => Topic::Telemetry,
            Self::Status(_) => Topic::Status,
            Self::Pose(_) => Topic::Pose,
            Self::Log(_) => Topic::Log,
            Self::Configuration(_) => Topic::Configuration,
            Self::Drops(_) => Topic::Drops,
        }
    }

    /// When it reached the host, in nanoseconds of the monotonic clock.
    #[must_use]
    pub const fn time_ns(&self) -> u64 {
        match self {
            Self::Tick(tick) => tick.start_ns,
            Self::Telemetry(record) => record.receive_time_ns,
            Self::Status(record) => record.receive_time_ns,
            Self::Pose(observation) => observation.receive_time_ns,
            Self::Log(log) => log.time_ns,
            Self::Configuration(configuration) => configuration.time_ns,
            Self::Drops(drops) => drops.time_ns,
        }
    }

    /// When what it tells of happened, in nanoseconds of the monotonic clock.
    #[must_use]
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

    /// Its fields, in the order of [`Topic::fields`]. A list shows as its length.
    #[must_use]
    pub fn values(&self) -> Vec<Value> {
        let mut values = Vec::new();
        with_entry!(self, message => message.visit(&mut Values::new(&mut values)));
        values
    }

    /// Adds it to `json` as one object on one line, without a line end: `topic`,
    /// then the fields of its message. Times are integers beyond 2^53; what is
    /// absent, and a quantity that is not a number, is null.
    pub fn write_json(&self, json: &mut String) {
        with_entry!(self, message => {
            Json::entry(json, self.topic(), |object| message.visit(object));
        });
    }

    /// Adds its message, encoded, to `bytes`.
    pub(crate) fn encode(&self, bytes: &mut Vec<u8>) -> Result<(), cdr_encoding::Error> {
        with_entry!(self, message => encode(&message, bytes))
    }

    /// The entry that `bytes` encode.
    pub(crate) fn decode(topic: Topic, bytes: &[u8]) -> Result<Self, String> {
        Ok(match topic {
            Topic::Tick => Self::Tick(
                TryInto::try_into(message::<TickMessage>(bytes)?)
                    .map_err(|error: Senseless| error.to_string())?,
            ),
            Topic::Telemetry => Self::Telemetry(message::<TelemetryMessage>(bytes)?.into()),
            Topic::Status => Self::Status(message::<StatusMessage>(bytes)?.into()),
            Topic::Pose => Self::Pose(
                TryInto::try_into(message::<PoseMessage>(bytes)?)
                    .map_err(|error: Senseless| error.to_string())?,
            ),
            Topic::Log => Self::Log(message::<LogMessage>(bytes)?.into()),
            Topic::Configuration => {
                Self::Configuration(message::<ConfigurationMessage>(bytes)?.into())
            }
            Topic::Drops => Self::Drops(message::<DropsMessage>(bytes)?.into()),
        })
    }
}

/// The message that `bytes` encode, no more and no less.
fn message<M: Message>(bytes: &[u8]) -> Result<M, String> {
    let Some(content) = bytes.strip_prefix(&ENCAPSULATION) else {
        return Err(format!(
            "a message begins with {:02x?}, not as little-endian CDR does",
            bytes.get(..4).unwrap_or(bytes)
        ));
    };
    let (message, length) =
        cdr_encoding::from_bytes::<M, LittleEndian>(content).map_err(|error| error.to_string())?;
    if length != content.len() {
        return Err(format!(
            "a message of {} has {} bytes too many",
            M::NAME,
            content.len().saturating_sub(length)
        ));
    }
    Ok(message)
}

#[cfg(test)]
pub(crate) mod tests;
