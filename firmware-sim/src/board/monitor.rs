//! Monitor of the messages at the board's end of the line.

use std::collections::VecDeque;

use singletrack_protocol::{COMMAND_TIME_TO_LIVE_US, Decoder, Telemetry, ToBoard, ToHost};

/// A message of the host that reached the board, accepted or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceivedMessage {
    /// Simulation time, in µs.
    pub time_us: u64,
    /// Board time, in µs, wrapping.
    pub board_time_us: u32,
    /// The decoded message.
    pub message: ToBoard,
}

/// Number of messages kept.
const CAPACITY: usize = 64;

/// Decodes both directions.
#[derive(Debug, Default)]
pub(super) struct Monitor {
    inbound: Decoder,
    outbound: Decoder,
    telemetry: Option<Telemetry>,
    last_command_us: Option<u32>,
    received: VecDeque<ReceivedMessage>,
}

impl Monitor {
    pub(super) fn next_received(&mut self) -> Option<ReceivedMessage> {
        self.received.pop_front()
    }

    pub(super) const fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    pub(super) const fn last_command_us(&self) -> Option<u32> {
        self.last_command_us
    }

    /// Processes a byte to the board.
    pub(super) fn host_byte(&mut self, byte: u8, time_us: u64, board_time_us: u32) {
        let Some(Ok(packet)) = self.inbound.push(byte) else {
            return;
        };
        let Ok(message) = ToBoard::decode(packet) else {
            return;
        };
        if self.received.len() >= CAPACITY {
            self.received.pop_front();
        }
        self.received.push_back(ReceivedMessage {
            time_us,
            board_time_us,
            message,
        });
        let telemetry_time_us = match message {
            ToBoard::Drive(drive) => drive.telemetry_time_us,
            ToBoard::Jog(jog) => jog.telemetry_time_us,
            _ => return,
        };
        // Other commands are refused.
        if board_time_us.wrapping_sub(telemetry_time_us) <= COMMAND_TIME_TO_LIVE_US {
            self.last_command_us = Some(telemetry_time_us);
        }
    }

    /// Processes a byte from the board.
    pub(super) fn board_byte(&mut self, byte: u8) {
        if let Some(Ok(packet)) = self.outbound.push(byte)
            && let Ok(ToHost::Telemetry(telemetry)) = ToHost::decode(packet)
        {
            self.telemetry = Some(telemetry);
        }
    }
}
