//! `[actuators]`: how fast steering and motor are believed to be.

use singletrack_control::{ActuatorModel, SteeringMap, SteeringTable};
use singletrack_settings::section;

use super::{ConfigError, ServoSection};

section! {
    /// How steering and motor are believed to follow their commands: dead time, then a lag of
    /// first order. `singletrack calibrate` measures them, and `compensation.actuation` uses
    /// them. The defaults are those of the simulated car.
    "actuators" => pub ActuatorsSection;
    [default];

    /// Time constant of the front wheels' angle.
    steering_lag_ms: f64 = 40.0, in 0.0..=1_000.0;
    /// Time from a command to the first movement of the front wheels: line, board, half a
    /// servo frame, and the servo.
    steering_dead_time_ms: f64 = 18.0, in 0.0..=500.0;
    /// Time constant of the speed.
    speed_lag_ms: f64 = 80.0, in 0.0..=2_000.0;
    /// Time from a command to the first change of the speed.
    speed_dead_time_ms: f64 = 36.0, in 0.0..=500.0;
    /// Pairs of servo pulse, in us, and angle of the front wheels, in rad, in the order of the
    /// pulses, for steering that is no straight line: not symmetric, with a dead band (equal
    /// angles) or a stop. Its pulses lie within those of `board.servo`, whose `centre_us` must steer
    /// straight by it, to 0.02 rad. Left out, `board.servo` is the line.
    steering_table: Option<Vec<[f64; 2]>> = None, text "2 to 32 pairs",
        example vec![[1_080.0, 0.525], [1_500.0, 0.0], [1_920.0, -0.525]];
}

/// The largest angle that a command for the board can carry, rounded down.
const MOST_COMMANDED_RAD: f64 = 3.2;

/// The most that the wheels may point aside at the pulse that the board holds them straight with.
const MOST_AT_CENTRE_RAD: f64 = 0.02;

impl ActuatorsSection {
    /// In s.
    #[must_use]
    pub fn model(&self) -> ActuatorModel {
        ActuatorModel {
            steering_dead_time: 1e-3 * self.steering_dead_time_ms,
            steering_lag: 1e-3 * self.steering_lag_ms,
            speed_dead_time: 1e-3 * self.speed_dead_time_ms,
            speed_lag: 1e-3 * self.speed_lag_ms,
        }
    }

    /// The angle of the front wheels over the pulse of this servo.
    ///
    /// # Errors
    ///
    /// The pairs are no table, or not one of this servo.
    pub fn steering_map(&self, servo: &ServoSection) -> Result<SteeringMap, ConfigError> {
        const KEY: &str = "actuators.steering_table";
        let centre_us = f64::from(servo.centre_us);
        let gain_us_per_rad = f64::from(servo.gain_us_per_rad);
        let map = |table| SteeringMap {
            centre_us,
            gain_us_per_rad,
            table,
        };
        let Some(pairs) = &self.steering_table else {
            return Ok(map(None));
        };
        let refuse = |fix: String| ConfigError::value(KEY, format!("{pairs:?}"), fix);
        let table = SteeringTable::new(pairs).map_err(|error| refuse(error.to_string()))?;
        for &[pulse, _] in pairs {
            if !(f64::from(servo.min_us)..=f64::from(servo.max_us)).contains(&pulse) {
                return Err(refuse(format!(
                    "{pulse} us lies outside board.servo.min_us to max_us, {} to {}",
                    servo.min_us, servo.max_us
                )));
            }
            if ((pulse - centre_us) / gain_us_per_rad).abs() > MOST_COMMANDED_RAD {
                return Err(refuse(format!(
                    "a command can't carry {pulse} us with board.servo.gain_us_per_rad = {}; \
                     raise its magnitude",
                    servo.gain_us_per_rad
                )));
            }
        }
        if (table.pairs()[0][1] > 0.0) != (gain_us_per_rad < 0.0) {
            return Err(refuse(format!(
                "the wheels turn to the other side with board.servo.gain_us_per_rad = {}; give \
                 it the other sign, or the angles",
                servo.gain_us_per_rad
            )));
        }
        let at_centre = table.angle(centre_us);
        if at_centre.abs() > MOST_AT_CENTRE_RAD {
            return Err(refuse(format!(
                "at board.servo.centre_us, {centre_us}, the wheels point {at_centre:.3} rad \
                 aside, but must within {MOST_AT_CENTRE_RAD}; set it to {:.0}",
                table.pulse(0.0)
            )));
        }
        Ok(map(Some(table)))
    }
}
