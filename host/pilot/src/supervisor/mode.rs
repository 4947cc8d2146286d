//! What the pilot is doing.

use crate::words::words;

words! {
    /// What the pilot is doing.
    pub enum Mode {
        /// There is no board to talk to.
        Disconnected = "disconnected",
        /// Something is missing for a drive; the reason says what.
        Idle = "idle",
        /// Everything is there; waiting to be armed.
        Ready = "ready",
        /// Waiting for the board to arm.
        Arming = "arming",
        /// Following the reference.
        Driving = "driving",
        /// Blind for longer than a pose may be held: the speed ramps down with the
        /// wheels held. A pose that comes back in time goes on with the drive.
        Slowing = "slowing",
        /// Slowing down to a stop, wheels held. Driving again takes an explicit arm.
        Stopping = "stopping",
        /// An emergency stop, or a state that can't be. A disarm request clears it;
        /// after an emergency stop so does a board that was reset.
        Fault = "fault",
    }
}

impl Mode {
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
