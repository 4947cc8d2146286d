//! How old the measurements are.

use super::SamplingError;

/// How old, at the tick, the values are that the law takes for the present ones, in s.
///
/// On the car the yaw rate is that of the newest inertial sample: it waits for the board's
/// telemetry, passes the serial line, and waits for the tick. Yaw and the velocity of G are
/// predicted to the tick by the estimator; their angle is the sideslip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ages {
    /// Of the yaw rate.
    pub yaw_rate: f64,
    /// Of the sideslip.
    pub sideslip: f64,
}

impl Ages {
    pub(super) fn validate(&self, most: f64) -> Result<(), SamplingError> {
        for (name, age) in [
            ("the age of the yaw rate in s", self.yaw_rate),
            ("the age of the sideslip in s", self.sideslip),
        ] {
            let is_valid = (0.0..=most).contains(&age);
            SamplingError::unless(is_valid, name, age, "between 0 and 1000 control periods")?;
        }
        Ok(())
    }
}
