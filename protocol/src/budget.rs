//! Load of the serial line, checked at compile time.

use crate::{
    Drive, Jog, Message, STATUS_PERIOD_US, Status, TELEMETRY_PERIOD_US, Telemetry,
    frame::{MAX_FRAME_LENGTH, frame_length},
};

/// 115200 baud, a start and a stop bit around every byte.
const LINE_BYTES_PER_S: u32 = 11_520;

/// Largest share of the line for periodic traffic. The rest is for answers, for a
/// clock that is 2 % off, and for catching up after a gap.
const LOAD_LIMIT_PERCENT: u32 = 40;

/// The board's receive buffer, in bytes.
pub const RECEIVE_BUFFER_LENGTH: usize = 128;

// In `u32`: `usize` has 16 bits on the board.
const fn bytes_per_s(payload_length: usize, period_us: u32) -> u32 {
    frame_length(payload_length) as u32 * (1_000_000 / period_us)
}

const TO_HOST_BYTES_PER_S: u32 = bytes_per_s(Telemetry::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US)
    + bytes_per_s(Status::PAYLOAD_LENGTH, STATUS_PERIOD_US);

// The host commands once per telemetry record.
const TO_BOARD_BYTES_PER_S: u32 = bytes_per_s(Drive::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US);

// A jog takes the place of a drive command.
const _: () = assert!(Jog::PAYLOAD_LENGTH <= Drive::PAYLOAD_LENGTH);

const _: () = assert!(TO_HOST_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);
const _: () = assert!(TO_BOARD_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);

// The longest frame, and the bytes that arrive in 5 ms, the longest time that an
// IMU transfer and a telemetry record keep the main loop busy.
const _: () =
    assert!(RECEIVE_BUFFER_LENGTH >= MAX_FRAME_LENGTH + (LINE_BYTES_PER_S * 5 / 1_000) as usize);
