//! What passes the board's end of the line, as an analyser there would see it.

use std::collections::VecDeque;

use singletrack_protocol::{COMMAND_TIME_TO_LIVE_US, Decoder, Telemetry, ToBoard, ToHost};

/// A message of the host that has reached the board, obeyed or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heard {
    /// Simulation time, in µs.
    pub time_us: u64,
    /// The same on the board's clock, in µs, wrapping.
    pub board_time_us: u32,
    /// What it says.
    pub message: ToBoard,
}

/// So many messages are kept for who does not fetch them.
const HEARD: usize = 64;

/// Listens to both directions.
#[derive(Debug, Default)]
pub(super) struct Monitor {
    inbound: Decoder,
    outbound: Decoder,
    telemetry: Option<Telemetry>,
    last_command_us: Option<u32>,
    heard: VecDeque<Heard>,
}

impl Monitor {
    pub(super) fn next_heard(&mut self) -> Option<Heard> {
        self.heard.pop_front()
    }

    pub(super) const fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    pub(super) const fn last_command_us(&self) -> Option<u32> {
        self.last_command_us
    }

    /// A byte reaches the board.
    pub(super) fn hear_host(&mut self, byte: u8, time_us: u64, board_time_us: u32) {
        let Some(Ok(packet)) = self.inbound.push(byte) else {
            return;
        };
        let Ok(message) = ToBoard::decode(packet) else {
            return;
        };
        if self.heard.len() >= HEARD {
            self.heard.pop_front();
        }
        self.heard.push_back(Heard {
            time_us,
            board_time_us,
            message,
        });
        if let ToBoard::Drive(drive) = message
            // The rest is refused, and keeps nothing in force.
            && board_time_us.wrapping_sub(drive.telemetry_time_us) <= COMMAND_TIME_TO_LIVE_US
        {
            self.last_command_us = Some(drive.telemetry_time_us);
        }
    }

    /// A byte leaves the board.
    pub(super) fn hear_board(&mut self, byte: u8) {
        if let Some(Ok(packet)) = self.outbound.push(byte)
            && let Ok(ToHost::Telemetry(telemetry)) = ToHost::decode(packet)
        {
            self.telemetry = Some(telemetry);
        }
    }
}
