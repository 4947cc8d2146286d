//! `[vehicle]`, `[limits]` and `[actuators]`: what the car is believed to be, what it may do, and how
//! fast its steering and motor follow.
//!
//! The types of the mathematics are read as they are; the sections declared here describe them.

use singletrack_control::{ActuatorModel, Limits, SteeringMap, SteeringTable, VehicleParameters};
use singletrack_settings::{Maps as _, section};

use super::{ConfigError, ServoSection};

section! {
    /// The car: the 1:10 car of the paper unless given. All of these keys or none.
    "vehicle" => pub(super) VehicleKeys;
    [maps VehicleParameters = VehicleParameters::paper()];

    /// Mass.
    mass_kg: f64 => mass_kg, text "above 0";
    /// Yaw moment of inertia about the centre of mass.
    yaw_inertia_kg_m2: f64 => yaw_inertia_kg_m2, text "above 0";
    /// Distance of the front axle from the centre of mass.
    front_axle_distance_m: f64 => front_axle_distance_m, text "above 0";
    /// Distance of the rear axle from the centre of mass.
    rear_axle_distance_m: f64 => rear_axle_distance_m, text "above 0";
    /// Friction coefficient between tyre and ground.
    friction: f64 => friction, text "above 0";
    /// Cornering stiffness of the front axle.
    front_cornering_stiffness_n_rad: f64 => front_cornering_stiffness_n_rad, text "above 0";
    /// Cornering stiffness of the rear axle.
    rear_cornering_stiffness_n_rad: f64 => rear_cornering_stiffness_n_rad, text "above 0";
}

section! {
    /// What the car may do.
    "limits" => pub LimitsSection: Copy;
    [maps Limits = Limits::paper()];

    /// Top speed forward.
    max_speed_m_s: f64 => max_speed, in up_to(20.0);
    /// Top speed in reverse, in which the law is unstable; 0 disables reverse.
    max_reverse_speed_m_s: f64 => max_reverse_speed, in 0.0..=20.0;
    /// Largest rate of change of the speed.
    max_acceleration_m_s2: f64 => max_acceleration, in up_to(50.0);
    /// Largest lateral acceleration, that of a steady bend with the tyres of `[vehicle]`. At
    /// most friction times gravity; beyond that the tyres slide.
    max_lateral_acceleration_m_s2: f64 => max_lateral_acceleration, in up_to(50.0);
    // The law is singular before 90 degrees.
    /// Largest steering angle to either side.
    max_steering_rad: f64 => max_steering, in up_to(1.2);
    /// Largest steering rate.
    max_steering_rate_rad_s: f64 => max_steering_rate, in up_to(50.0);
    /// Speed at which the car turns round when P should move backward. It brakes instead
    /// where P is ahead of a reference that moves forward and comes within a second.
    creep_speed_m_s: f64 => creep_speed, in up_to(max_speed_m_s);
    /// A wanted velocity below this is standstill.
    standstill_speed_m_s: f64 => standstill_speed, in up_to(max_speed_m_s);
}

impl LimitsSection {
    /// For the controller of a car with this wheelbase, in m.
    #[must_use]
    pub fn limits(&self, wheelbase: f64) -> Limits {
        self.apply_to(Limits {
            wheelbase,
            ..Limits::paper()
        })
    }
}

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
