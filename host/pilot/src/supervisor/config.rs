//! The supervisor's limits.

/// The supervisor's limits, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// The longest age of a pose to drive with, from its mid-exposure, s. Beyond it the
    /// car slows down.
    pub hold: f64,
    /// The farthest that the car may go without a pose before it slows down, m: at
    /// speed, `hold` alone would let it go too far.
    pub hold_distance: f64,
    /// The age of the last pose at which a slowing car stops for good, s.
    pub blind: f64,
    /// The distance without a pose at which a slowing car stops for good, m.
    pub blind_distance: f64,
    /// The longest age of a pose to arm, and for a slowing car to drive on, s.
    pub fresh: f64,
    /// The longest time without an inertial sample, s.
    pub imu_silence: f64,
    /// To arm, the yaw rate must have been below this for 20 samples, rad/s...
    pub still_yaw_rate: f64,
    /// ...and the acceleration below this, m/s².
    pub still_acceleration: f64,
    /// The longest time that the board may take to arm, s.
    pub arm_timeout: f64,
    /// The number of accepted poses after which the estimate has settled.
    pub settling_poses: u32,
    /// The number of implausible poses in a row that stops the car.
    pub max_implausible: u32,
    /// The longest time for a stop, s; then the board is disarmed in any case.
    pub stop_timeout: f64,
    /// The car stands below this speed, m/s.
    pub standing_speed: f64,
    /// The lowest battery voltage to drive with, V; 0 disables the check.
    pub min_battery: f64,
    /// The lowest battery voltage to arm with, V; 0 disables the check.
    pub arm_battery: f64,
    /// The largest fraction of damaged frames, in either direction, 0 to 1.
    pub max_damaged: f64,
    /// The age of the last pose at which the board is disarmed in any case, s: before the
    /// board stops the car by itself.
    pub disarm_age: f64,
    /// Whether a configuration is proved on the first metre that it drives on a car.
    pub prove: bool,
    /// Whether the car may drive only with real-time scheduling and locked memory.
    pub require_real_time: bool,
}

impl SupervisorConfig {
    /// For the paper's car.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            hold: 0.3,
            hold_distance: 0.15,
            blind: 0.6,
            blind_distance: 0.45,
            fresh: 0.05,
            imu_silence: 0.1,
            still_yaw_rate: 0.1,
            still_acceleration: 1.0,
            arm_timeout: 0.5,
            settling_poses: 50,
            max_implausible: 20,
            stop_timeout: 1.5,
            standing_speed: 0.03,
            min_battery: 6.4,
            arm_battery: 6.8,
            max_damaged: 0.5,
            disarm_age: 0.91,
            prove: true,
            require_real_time: false,
        }
    }
}
