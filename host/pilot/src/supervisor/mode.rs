//! The modes of the pilot.

use singletrack_words::words;

words! {
    /// The mode of the pilot. The table of transitions is in `supervisor`.
    pub enum Mode {
        /// There is no usable link to a board.
        Disconnected = 1 "disconnected",
        /// The arming check fails; the reason is why, or why the last drive ended.
        Idle = 2 "idle",
        /// The arming check passes; the pilot waits for an arm request.
        Ready = 3 "ready",
        /// The board has been asked to arm.
        Arming = 4 "arming",
        /// The car follows the reference.
        Driving = 5 "driving",
        /// The last pose is too old to drive with: the speed ramps down, the steering is
        /// held. The drive goes on if fresh poses come in time.
        Slowing = 8 "slowing",
        /// The speed ramps down to zero, the steering is held; then the board is disarmed.
        /// The next drive needs an arm request.
        Stopping = 6 "stopping",
        /// An emergency stop, or a state at which the law is singular. A disarm request
        /// clears it, unless the board is still latched. After an emergency stop, a reset of
        /// the board clears it too.
        Fault = 7 "fault",
        /// Servo and ESC get the operator's bare pulses, for as long as they are renewed.
        Jogging = 9 "jogging",
    }
}

impl Mode {
    /// Whether a drive is underway: the car may move, and no configuration is replaced.
    #[must_use]
    pub const fn is_underway(self) -> bool {
        matches!(
            self,
            Self::Arming | Self::Driving | Self::Slowing | Self::Stopping | Self::Jogging
        )
    }

    /// Whether the pilot sends commands to the board.
    #[must_use]
    pub const fn commands(self) -> bool {
        matches!(
            self,
            Self::Driving | Self::Slowing | Self::Stopping | Self::Jogging
        )
    }
}
