//! Why a set-point has no effect.

use core::fmt;

use singletrack_control::SetpointError;

/// Why a set-point has no effect, as a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The line is no set-point.
    Invalid,
    /// A value is infinite or not a number.
    NotFinite,
    /// A value is beyond that of any car, or a trajectory is not one.
    OutOfRange,
    /// It was decided later than now, or its trajectory begins too late.
    Future,
    /// It is older than the time-out, or its trajectory is over.
    Old,
    /// Its number is not above the last one of this connection.
    Sequence,
    /// Another connection gives the set-points.
    OtherSource,
    /// The reference in force is not external.
    NotExternal,
}

impl Rejection {
    /// Every one.
    pub const ALL: [Self; 8] = [
        Self::Invalid,
        Self::NotFinite,
        Self::OutOfRange,
        Self::Future,
        Self::Old,
        Self::Sequence,
        Self::OtherSource,
        Self::NotExternal,
    ];

    /// The word in answers and figures.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Invalid => "invalid",
            Self::NotFinite => "not-finite",
            Self::OutOfRange => "out-of-range",
            Self::Future => "future",
            Self::Old => "old",
            Self::Sequence => "sequence",
            Self::OtherSource => "other-source",
            Self::NotExternal => "not-external",
        }
    }
}

impl From<SetpointError> for Rejection {
    fn from(error: SetpointError) -> Self {
        match error {
            SetpointError::NotFinite => Self::NotFinite,
            SetpointError::OutOfRange(_) | SetpointError::Incomplete => Self::OutOfRange,
            SetpointError::Future => Self::Future,
            SetpointError::Old | SetpointError::Superseded => Self::Old,
        }
    }
}

/// Why a set-point has no effect: the text of the answer and the word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejected {
    /// The word.
    pub why: Rejection,
    /// The text.
    pub text: String,
}

impl Rejected {
    /// With a text.
    #[must_use]
    pub fn new(why: Rejection, text: impl fmt::Display) -> Self {
        Self {
            why,
            text: text.to_string(),
        }
    }
}
