//! Messages and frames between the host and the board.
//!
//! The host (Odroid) and the board (Arduino UNO) exchange [`ToBoard`] and
//! [`ToHost`] messages over a serial line. Every message is one frame:
//!
//! ```text
//! COBS( type: u8 | payload: postcard, fixed-width little-endian | CRC-16/X-25: u16 ) 00
//! ```
//!
//! # Version policy
//!
//! Versions must match exactly: host and board that differ refuse to arm. Any
//! change of a layout, a type byte or a meaning increments [`VERSION`]. [`Hello`],
//! its type byte and the framing never change, so that incompatible versions can
//! still report each other. Golden tests freeze the bytes of every version: if one
//! fails, either the change is wrong or [`VERSION`] must be incremented.
//!
//! # Physics
//!
//! This crate contains no physics. Quantities are scaled integers with the unit in
//! the name; board and host interpret them.

#![no_std]

#[cfg(test)]
extern crate std;

mod codec;
mod configuration;
mod frame;
mod message;
mod report;
mod wire;
#[path = "../../host/control/src/words.rs"]
mod words;

pub use configuration::{
    Configuration, ConfigurationError, ConfigurationField, EscCalibration, EscKind, FailsafeAction,
    ImuAxes, ImuAxis, ServoCalibration, SpeedLoop,
};
pub use frame::{
    Decoder, Frame, FrameError, MAX_FRAME_LENGTH, MAX_PAYLOAD_LENGTH, Packet, frame_length,
};
pub use message::{
    Arm, Configure, DecodeError, Disarm, Drive, EmergencyStop, Hello, Identity, Jog, Message,
    MessageType, RECEIVE_BUFFER_LENGTH, Sequence, ToBoard, ToHost, UNNAMED, UNSOLICITED,
};
pub use report::{
    Acknowledgement, BoardMode, ImuState, Refusal, RefusalReason, Request, ResetCause, Status,
    StopCause, Telemetry,
};

/// The protocol version; see the crate's version policy.
pub const VERSION: u16 = 3;

/// Time to live of a command, in microseconds of board time. The board refuses a
/// [`Drive`], [`Jog`] or [`Arm`] whose underlying telemetry is older; an accepted
/// [`Drive`] or [`Jog`] stays in force this long after that telemetry.
///
/// With one servo period (20 ms) and one supervisor period (1 ms) on top, the
/// neutral pulse leaves the board within 120 ms of the last valid command.
pub const COMMAND_TIME_TO_LIVE_US: u32 = 95_000;

/// Upper limit of [`Configuration::max_pose_age_ms`], in milliseconds.
///
/// This limit is compiled in, so that no configuration lets the board follow a host
/// without a newer pose.
pub const MAX_POSE_AGE_CEILING_MS: u16 = 1_000;

/// [`Configuration::max_roll_out_ms`] of a board that has no configuration, in
/// milliseconds.
pub const LONGEST_ROLL_OUT_MS: u16 = 5_000;

/// Largest difference between the ESC pulse of a [`Jog`] and neutral, in µs.
pub const JOG_LIMIT_US: u16 = 150;

/// Speed of the wheels above which the board ends jogging, in mm/s.
pub const JOG_SPEED_MM_S: i16 = 1_000;

/// Longest time for which the motor is jogged, in microseconds. It begins again when
/// the ESC is at neutral and the wheels have come to rest.
pub const JOG_DRIVE_US: u32 = 10_000_000;

/// Period of [`Telemetry`] in microseconds (100 Hz).
pub const TELEMETRY_PERIOD_US: u32 = 10_000;

/// Period of [`Status`] in microseconds (5 Hz).
pub const STATUS_PERIOD_US: u32 = 200_000;
