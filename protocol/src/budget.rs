//! What the wire can carry, checked when this crate is compiled.

use crate::frame::{MAX_FRAME_LENGTH, frame_length};
use crate::{Drive, Message, STATUS_PERIOD_US, Status, TELEMETRY_PERIOD_US, Telemetry};

/// 115200 baud, a start and a stop bit around every byte.
const LINE_BYTES_PER_S: u32 = 11_520;

/// The share of the line that periodic traffic may take: the rest is for
/// answers, for a clock that is 2 % off, and for catching up after a gap.
const LOAD_LIMIT_PERCENT: u32 = 40;

/// The board's receive buffer, in bytes.
pub const RECEIVE_BUFFER_LENGTH: usize = 128;

// In `u32`: a `usize` of the board has 16 bits.
const fn bytes_per_s(payload_length: usize, period_us: u32) -> u32 {
    frame_length(payload_length) as u32 * (1_000_000 / period_us)
}

const TO_HOST_BYTES_PER_S: u32 = bytes_per_s(Telemetry::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US)
    + bytes_per_s(Status::PAYLOAD_LENGTH, STATUS_PERIOD_US);

// The host commands once per telemetry record.
const TO_BOARD_BYTES_PER_S: u32 = bytes_per_s(Drive::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US);

const _: () = assert!(TO_HOST_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);
const _: () = assert!(TO_BOARD_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);

// The longest frame, and all that can arrive in the 5 ms that the main loop may
// at worst be busy with an IMU transfer and a telemetry record.
const _: () =
    assert!(RECEIVE_BUFFER_LENGTH >= MAX_FRAME_LENGTH + (LINE_BYTES_PER_S * 5 / 1_000) as usize);
