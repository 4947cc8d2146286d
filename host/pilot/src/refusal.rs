//! Why the pilot does not obey a set-point that reached it.

use singletrack_control::SetpointError;

use crate::words::words;

words! {
    /// Why the pilot does not obey a set-point that reached it.
    pub enum SetpointRefusal {
        /// A value is infinite or not a number.
        NotFinite = "not-finite",
        /// A value is beyond that of any car, or a trajectory is not one.
        OutOfRange = "out-of-range",
        /// It was decided later than the tick.
        Future = "future",
        /// It is older than the time-out, or its trajectory is over.
        Old = "old",
        /// One that was decided later is in force.
        Superseded = "superseded",
        /// Points of the trajectory are missing.
        Incomplete = "incomplete",
        /// The reference in force takes no set-points.
        NotExternal = "not-external",
    }
}

impl From<SetpointError> for SetpointRefusal {
    fn from(error: SetpointError) -> Self {
        match error {
            SetpointError::NotFinite => Self::NotFinite,
            SetpointError::OutOfRange(_) => Self::OutOfRange,
            SetpointError::Future => Self::Future,
            SetpointError::Old => Self::Old,
            SetpointError::Superseded => Self::Superseded,
            SetpointError::Incomplete => Self::Incomplete,
        }
    }
}
