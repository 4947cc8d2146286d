//! The messages of a record. Each is declared once: the type that is encoded, the
//! `ros2msg` schema in the file, the fields that are printed and the conversion from
//! and to the record's own types all follow from that declaration.
//!
//! The documentation of a field is its comment in the schema. A value that may be
//! absent takes two fields there, `bool has_x` and `x`, because ROS messages have no
//! options.

mod board;
mod code;
mod declare;
mod definition;
mod event;
mod field;
mod floor;
mod log;
mod pose;
mod tick;

pub(crate) use board::{StatusMessage, TelemetryMessage};
pub(crate) use code::Coded;
pub(crate) use declare::{Fields, Message, schema_name, schema_text};
pub(crate) use definition::Definition;
pub(crate) use field::Represents;
pub(crate) use log::{ConfigurationMessage, DropsMessage, LogMessage};
pub(crate) use pose::PoseMessage;
pub(crate) use tick::TickMessage;
