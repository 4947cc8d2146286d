//! The line to the board: its port as the serial reader uses it, and its write half
//! as the control loop uses it.

use singletrack_protocol::{Decoder, Drive, Message, Sequence, ToBoard, frame_length};

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

/// Bounds the output queue of a port: at most two commands wait.
///
/// A driver reports its queue in bytes (FTDI, CH340), in whole transfers however short they are
/// (that of a genuine UNO, 1280 bytes each), or not at all (a pseudo-terminal). What was written
/// since it was last empty is another upper bound, and the lower one counts.
#[derive(Clone, Copy, Debug, Default)]
pub struct OutputQueue {
    written: usize,
}

/// The largest queue, in bytes, for which another frame is written.
const MAX_QUEUED: usize = frame_length(Drive::PAYLOAD_LENGTH);

impl OutputQueue {
    /// Whether a frame may be written while the driver reports `queued` bytes.
    pub fn has_room(&mut self, queued: usize) -> bool {
        if queued == 0 {
            self.written = 0;
        }
        queued.min(self.written) <= MAX_QUEUED
    }

    /// Bytes were written.
    pub const fn wrote(&mut self, bytes: usize) {
        self.written = self.written.saturating_add(bytes);
    }
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
    use singletrack_protocol::{Disarm, Jog};

    use super::*;

    #[test]
    fn two_commands_wait_however_the_driver_counts_them() {
        // A driver that counts bytes, and one that counts transfers.
        for count in [
            |bytes: usize| bytes,
            |bytes: usize| bytes.div_ceil(MAX_QUEUED) * 1_280,
        ] {
            let mut queue = OutputQueue::default();
            let mut queued = 0;
            let write = |queue: &mut OutputQueue, queued: &mut usize| {
                let room = queue.has_room(count(*queued));
                if room {
                    queue.wrote(MAX_QUEUED);
                    *queued += MAX_QUEUED;
                }
                room
            };
            // The line is stuck.
            let taken = (0..10).filter(|_| write(&mut queue, &mut queued)).count();
            assert_eq!(taken, 2);
            // It goes on; two frames fit in each tick.
            for _ in 0..10 {
                queued = 0;
                assert!(write(&mut queue, &mut queued) && write(&mut queue, &mut queued));
                assert!(!write(&mut queue, &mut queued));
            }
        }
    }

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
