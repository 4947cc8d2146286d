//! The modes of the pilot.

use core::fmt;

/// The mode of the pilot. The table of transitions is in `supervisor`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// There is no usable link to a board.
    Disconnected,
    /// The arming check fails; the reason is why, or why the last drive ended.
    Idle,
    /// The arming check passes; the pilot waits for an arm request.
    Ready,
    /// The board has been asked to arm.
    Arming,
    /// The car follows the reference.
    Driving,
    /// The last pose is too old to drive with: the speed ramps down, the steering is
    /// held. The drive goes on if fresh poses come in time.
    Slowing,
    /// The speed ramps down to zero, the steering is held; then the board is disarmed.
    /// The next drive needs an arm request.
    Stopping,
    /// An emergency stop, or a state at which the law is singular. A disarm request
    /// clears it, unless the board is still latched. After an emergency stop, a reset of
    /// the board clears it too.
    Fault,
}

impl Mode {
    /// Every mode, in the order of declaration.
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

    /// The word for the mode in status, log and record.
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

    /// Whether a drive is underway: the car may move, and no configuration is replaced.
    #[must_use]
    pub const fn is_underway(self) -> bool {
        matches!(
            self,
            Self::Arming | Self::Driving | Self::Slowing | Self::Stopping
        )
    }

    /// Whether the pilot sends drive commands to the board.
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
