//! What passes the board's end of the line, as an analyser there would see it.

use singletrack_protocol::{COMMAND_TIME_TO_LIVE_US, Decoder, Telemetry, ToBoard, ToHost};

/// Listens to both directions.
#[derive(Debug, Default)]
pub(super) struct Monitor {
    inbound: Decoder,
    outbound: Decoder,
    telemetry: Option<Telemetry>,
    last_command_us: Option<u32>,
}

impl Monitor {
    pub(super) const fn telemetry(&self) -> Option<&Telemetry> {
        self.telemetry.as_ref()
    }

    pub(super) const fn last_command_us(&self) -> Option<u32> {
        self.last_command_us
    }

    /// A byte reaches the board.
    pub(super) fn hear_host(&mut self, byte: u8, board_time_us: u32) {
        if let Some(Ok(packet)) = self.inbound.push(byte)
            && let Ok(ToBoard::Drive(drive)) = ToBoard::decode(packet)
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
