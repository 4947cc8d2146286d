//! `[actuators]`: how fast steering and motor are believed to be.

use super::section::section;

section! {
    /// How steering and motor are believed to follow their pulses: dead time, then a lag of
    /// first order. `singletrack calibrate` measures them. They describe the car for analyses
    /// and simulations; the controller does not use them.
    "actuators" => pub ActuatorsSection: Copy;
    [default];

    /// Time constant of the front wheels' angle.
    steering_lag_ms: f64 = 40.0, in 0.0..=1_000.0;
    /// Time from a servo pulse to the first movement of the front wheels.
    steering_dead_time_ms: f64 = 12.0, in 0.0..=500.0;
    /// Time constant of the speed.
    speed_lag_ms: f64 = 80.0, in 0.0..=2_000.0;
    /// Time from an ESC pulse to the first change of the speed.
    speed_dead_time_ms: f64 = 30.0, in 0.0..=500.0;
}
