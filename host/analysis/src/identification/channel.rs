//! The measured quantities.

/// A measured quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    /// Position along x.
    X,
    /// Position along y.
    Y,
    /// Yaw from the cameras.
    Yaw,
    /// Yaw rate from the gyro.
    YawRate,
    /// Acceleration to the left.
    Left,
}

impl Channel {
    /// All channels.
    pub const ALL: [Self; 5] = [Self::X, Self::Y, Self::Yaw, Self::YawRate, Self::Left];

    /// The name in tables and files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Yaw => "yaw",
            Self::YawRate => "yaw_rate",
            Self::Left => "left_acceleration",
        }
    }

    /// The unit.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::X | Self::Y => "m",
            Self::Yaw => "rad",
            Self::YawRate => "rad/s",
            Self::Left => "m/s²",
        }
    }
}
