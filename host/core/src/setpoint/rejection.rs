//! Why a set-point has no effect.

use core::fmt;

use singletrack_control::SetpointError;
use singletrack_words::words;

words! {
    /// Why a set-point has no effect, as the word in answers and figures.
    pub enum Rejection {
        /// The line is no set-point.
        Invalid = "invalid",
        /// A value is infinite or not a number.
        NotFinite = "not-finite",
        /// A value is beyond that of any car, or a trajectory is not one.
        OutOfRange = "out-of-range",
        /// It was decided later than now, or its trajectory begins too late.
        Future = "future",
        /// It is older than the time-out, or its trajectory is over.
        Old = "old",
        /// Its number is not above the last one of this connection.
        Sequence = "sequence",
        /// Another connection gives the set-points.
        OtherSource = "other-source",
        /// The reference in force is not external.
        NotExternal = "not-external",
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
