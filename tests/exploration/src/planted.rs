//! Mistakes that the exploration must find.

use singletrack_protocol::ToBoard;

/// A mistake on the way to the board, or at the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planted {
    /// An emergency stop is not passed on to the supervisor.
    StopIgnored,
    /// A command counts from its arrival, not from the telemetry behind it.
    CommandRenewed,
    /// A request to disarm is passed on as one to arm.
    DisarmArms,
    /// The board does not hear that it is to disarm.
    DisarmLost,
}

impl Planted {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::StopIgnored,
        Self::CommandRenewed,
        Self::DisarmArms,
        Self::DisarmLost,
    ];

    pub(crate) fn tamper(self, arrived: &mut Vec<ToBoard>, board_us: u32) {
        match self {
            Self::StopIgnored | Self::DisarmArms => {}
            Self::CommandRenewed => {
                for message in arrived {
                    if let ToBoard::Drive(drive) = message {
                        drive.telemetry_time_us = board_us;
                    }
                }
            }
            Self::DisarmLost => arrived.retain(|message| !matches!(message, ToBoard::Disarm(_))),
        }
    }
}
