//! The ranges of the settings.

use singletrack_settings::{Declared as _, Worded, in_words};

use super::{ConfigError, SimulationConfig};

/// Any number.
pub(crate) const FINITE: Worded = in_words("finite", |_| true);
/// Above zero.
pub(crate) const POSITIVE: Worded = in_words("finite and above zero", |x| x > 0.0);
/// Zero or above.
pub(crate) const NOT_NEGATIVE: Worded = in_words("finite and not negative", |x| x >= 0.0);
/// A probability.
pub(crate) const PROBABILITY: Worded =
    in_words("a probability from 0 to 1", |x| (0.0..=1.0).contains(&x));
/// A rate of edges, per second.
pub(crate) const EDGE_RATE: Worded =
    in_words("between 0 and 100000", |x| (0.0..=100_000.0).contains(&x));
/// The time constant of a lag, in s: the integrator's step is a millisecond.
pub(crate) const LAG: Worded = in_words("0.002 or more", |x| x >= 0.002);
/// A period, in µs.
pub(crate) const PERIOD: Worded = in_words("1000 or more", |x| x >= 1_000.0);

impl SimulationConfig {
    /// Checks all settings against their ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let car = &self.car;
        car.vehicle.validate()?;
        car.servo.check()?;
        car.motor.check()?;
        if let Some(push) = &car.motor.push {
            push.check()?;
        }
        car.motor_sensor.check()?;
        car.battery.check()?;
        car.imu.check()?;
        self.cameras.check()?;
        self.board.check()?;
        self.wire.check()?;
        Ok(self.wire.faults.check()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_keys_and_invalid_values_are_reported_by_name() {
        let error = toml::from_str::<SimulationConfig>("[car.servo]\nlagg_s = 1").unwrap_err();
        assert!(error.to_string().contains("lagg_s"), "{error}");
        let config: SimulationConfig = toml::from_str("[wire.faults]\ncorrupt = 1.5").unwrap();
        assert_eq!(
            config.validate().unwrap_err().to_string(),
            "wire.faults.corrupt is 1.5: it must be a probability from 0 to 1"
        );
        let error = toml::from_str::<SimulationConfig>("[cameras]\nloss = \"1s\"").unwrap_err();
        assert!(error.to_string().contains("DURATION@INTERVAL"), "{error}");
        let error =
            toml::from_str::<SimulationConfig>("[natnet]\nbitstream = \"2.5\"").unwrap_err();
        assert!(error.to_string().contains("2.5"), "{error}");
    }
}
