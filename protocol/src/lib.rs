//! What the two computers of the car say to each other.
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
//! [`VERSION`] is exact-match: host and board that differ refuse to arm. Any
//! change of a layout, a type byte or a meaning raises it. [`Hello`], its type
//! byte and the framing never change, so that two versions that cannot talk
//! can still name each other. The bytes of every version are frozen by the
//! golden tests: a golden test that fails says that the change is wrong, or
//! that [`VERSION`] has to rise.
//!
//! # Physics
//!
//! None. Quantities are scaled integers with the unit in the name; what they
//! do to the car is the board's and the host's business.

#![no_std]

#[cfg(test)]
extern crate std;

mod budget;
mod codec;
mod command;
mod configuration;
mod crc;
mod fixint_array;
mod frame;
mod hello;
mod message;
mod report;
mod validation;

pub use budget::RECEIVE_BUFFER_LENGTH;

pub use command::{Arm, Disarm, Drive, EmergencyStop, Sequence};
pub use configuration::{
    Configuration, EscCalibration, FailsafeAction, ServoCalibration, SpeedLoop,
};
pub use frame::{
    Decoder, Frame, FrameError, MAX_FRAME_LENGTH, MAX_PAYLOAD_LENGTH, Packet, frame_length,
};
pub use hello::{Hello, UNSOLICITED};
pub use message::{Configure, DecodeError, Message, MessageType, ToBoard, ToHost};
pub use report::{
    Acknowledgement, BoardMode, ImuState, Refusal, RefusalReason, Request, ResetCause, Status,
    StopCause, Telemetry,
};

pub use validation::{ConfigurationError, ConfigurationField};

/// The protocol version. Exact match: see the crate's version policy.
pub const VERSION: u16 = 1;

/// How old the telemetry that a [`Drive`] or [`Arm`] was based on may be, in
/// microseconds of board time, before the board refuses it; and how long after
/// that telemetry an accepted [`Drive`] stays in force.
///
/// With one servo period (20 ms) and one supervisor period (1 ms) on top, the
/// neutral pulse leaves the board within 120 ms of the last valid command.
pub const COMMAND_TIME_TO_LIVE_US: u32 = 95_000;

/// The largest pose age that any configuration may allow, in milliseconds.
///
/// Compiled in: no configuration can make the board follow a host that has
/// been blind for longer.
pub const MAX_POSE_AGE_CEILING_MS: u16 = 1_000;

/// Period of [`Telemetry`] in microseconds (100 Hz).
pub const TELEMETRY_PERIOD_US: u32 = 10_000;

/// Period of [`Status`] in microseconds (5 Hz).
pub const STATUS_PERIOD_US: u32 = 200_000;
