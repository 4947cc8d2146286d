//! The line to the board: its port as the serial reader uses it, and its write half
//! as the control loop uses it.

use singletrack_protocol::{Decoder, Sequence, ToBoard};

/// The write half: accepts frames for the board, whole or not at all.
pub trait Line: Send {
    /// Writes a frame without waiting.
    fn write_frame(&mut self, frame: &[u8]) -> Sent;
}

/// Whether a frame was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The port accepted the whole frame.
    Whole,
    /// The port did not; the frame was dropped in favour of a newer one.
    Dropped,
}

/// The board's port.
pub trait Port {
    /// Its write half.
    type Line: Line;

    /// Opens the port; `None` if that fails.
    fn open(&mut self) -> Option<Self::Line>;

    /// Reads without waiting.
    fn read(&mut self, buffer: &mut [u8]) -> PortRead;

    /// Closes the read half after a hang-up.
    fn close(&mut self);
}

/// The outcome of a read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortRead {
    /// Nothing to read now.
    Nothing,
    /// The number of bytes, at least one.
    Bytes(usize),
    /// The port has hung up.
    HungUp,
}

/// The number of the command to drive or to jog that a frame holds, if it holds one.
#[must_use]
pub fn drive_number(frame: &[u8]) -> Option<Sequence> {
    let mut decoder = Decoder::new();
    frame.iter().find_map(|&byte| {
        let packet = decoder.push(byte)?.ok()?;
        match ToBoard::decode(packet) {
            Ok(ToBoard::Drive(drive)) => Some(drive.sequence),
            Ok(ToBoard::Jog(jog)) => Some(jog.sequence),
            _ => None,
        }
    })
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{Disarm, Drive, Jog, Message, frame_length};

    use super::*;

    #[test]
    fn only_commands_to_drive_or_to_jog_have_a_number() {
        for number in [0, 1, 0x13, 255] {
            let drive = Drive {
                sequence: Sequence(number),
                speed_mm_s: 0,
                steering_100urad: -3_000,
                telemetry_time_us: 0,
                pose_age_ms: 12,
                brake: false,
            };
            let frame = ToBoard::from(drive).encode();
            assert_eq!(frame.as_bytes().len(), frame_length(Drive::PAYLOAD_LENGTH));
            assert_eq!(drive_number(frame.as_bytes()), Some(Sequence(number)));
        }
        let jog = ToBoard::from(Jog {
            sequence: Sequence(8),
            telemetry_time_us: 0,
            servo_us: 1_500,
            esc_us: 1_500,
        });
        assert_eq!(drive_number(jog.encode().as_bytes()), Some(Sequence(8)));
        let disarm = ToBoard::from(Disarm {
            request: Sequence(7),
        });
        assert_eq!(drive_number(disarm.encode().as_bytes()), None);
        assert_eq!(drive_number(&[]), None);
    }
}
