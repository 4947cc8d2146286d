//! `[actuators]`: how fast steering and motor are believed to be.

use singletrack_control::ActuatorModel;

use super::section::section;

section! {
    /// How steering and motor are believed to follow their commands: dead time, then a lag of
    /// first order. `singletrack calibrate` measures them, and `compensation.actuation` uses
    /// them. The defaults are those of the simulated car.
    "actuators" => pub ActuatorsSection: Copy;
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
}

impl ActuatorsSection {
    /// In s.
    pub(super) fn model(&self) -> ActuatorModel {
        ActuatorModel {
            steering_dead_time: 1e-3 * self.steering_dead_time_ms,
            steering_lag: 1e-3 * self.steering_lag_ms,
            speed_dead_time: 1e-3 * self.speed_dead_time_ms,
            speed_lag: 1e-3 * self.speed_lag_ms,
        }
    }
}
