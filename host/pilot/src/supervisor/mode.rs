//! What the pilot is doing.

use core::fmt;

/// What the pilot is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// There is no board to talk to.
    Disconnected,
    /// Something is missing for a drive; the reason says what.
    Idle,
    /// Everything is there; waiting to be armed.
    Ready,
    /// Waiting for the board to arm.
    Arming,
    /// Following the reference.
    Driving,
    /// Blind for longer than a pose may be held: the speed ramps down with the
    /// wheels held. A pose that comes back in time goes on with the drive.
    Slowing,
    /// Slowing down to a stop, wheels held. Driving again takes an explicit arm.
    Stopping,
    /// An emergency stop, or a state that can't be. A disarm request clears it;
    /// after an emergency stop so does a board that was reset.
    Fault,
}

impl Mode {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Disconnected,
        Self::Idle,
        Self::Ready,
        Self::Arming,
        Self::Driving,
        Self::Slowing,
        Self::Stopping,
        Self::Fault,
    ];

    /// The name of the mode in status, log and record.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Idle => "idle",
            Self::Ready => "ready",
            Self::Arming => "arming",
            Self::Driving => "driving",
            Self::Slowing => "slowing",
            Self::Stopping => "stopping",
            Self::Fault => "fault",
        }
    }

    /// Whether a drive has begun, or is about to, and has not come to its end:
    /// the car may move, and nothing is reconfigured.
    #[must_use]
    pub const fn is_underway(self) -> bool {
        matches!(
            self,
            Self::Arming | Self::Driving | Self::Slowing | Self::Stopping
        )
    }

    /// Whether the board is sent commands.
    #[must_use]
    pub const fn commands(self) -> bool {
        matches!(self, Self::Driving | Self::Slowing | Self::Stopping)
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
