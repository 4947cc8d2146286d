//! The measured quantities.

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    /// Position along x.
    X,
    /// Position along y.
    Y,
    /// Yaw by the cameras.
    Yaw,
    /// Yaw rate by the gyro.
    YawRate,
    /// Acceleration to the left.
    Left,
}

impl Channel {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::X, Self::Y, Self::Yaw, Self::YawRate, Self::Left];

    /// Its name.
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

    /// Its unit.
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
