//! Why the pilot does not obey a set-point that reached it.

use singletrack_control::SetpointError;

use singletrack_words::words;

words! {
    /// Why the pilot does not obey a set-point that reached it.
    pub enum SetpointRefusal {
        /// A value is infinite or not a number.
        NotFinite = 1 "not-finite",
        /// A value is beyond that of any car, or a trajectory is not one.
        OutOfRange = 2 "out-of-range",
        /// It was decided later than the tick.
        Future = 3 "future",
        /// It is older than the time-out, or its trajectory is over.
        Old = 4 "old",
        /// One that was decided later is in force.
        Superseded = 5 "superseded",
        /// Points of the trajectory are missing.
        Incomplete = 6 "incomplete",
        /// The reference in force takes no set-points.
        NotExternal = 7 "not-external",
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
