//! The supervisor's limits.

/// The supervisor's limits, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// A pose may be held for so long after its mid-exposure, s; then the car
    /// slows down.
    pub hold: f64,
    /// And for so far, m: what `hold` allows at a walk is too long at speed.
    pub hold_distance: f64,
    /// Blind for longer than this, s, a slowing car stops for good.
    pub blind: f64,
    /// And having gone farther than this, m.
    pub blind_distance: f64,
    /// A pose must be younger than this to arm, and for a slowing car to drive
    /// on, s.
    pub fresh: f64,
    /// No inertial sample for this long stops the car, s.
    pub imu_silence: f64,
    /// To arm, the yaw rate must have been below this for a while, rad/s...
    pub still_yaw_rate: f64,
    /// ...and the acceleration below this, m/s².
    pub still_acceleration: f64,
    /// How long the board may take to arm, s.
    pub arm_timeout: f64,
    /// Poses that the estimate needs to settle.
    pub settling_poses: u32,
    /// This many implausible poses in a row stop the car.
    pub max_implausible: u32,
    /// Slowing down may take this long; then the board is disarmed anyway, s.
    pub stop_timeout: f64,
    /// Below this speed the car stands, m/s.
    pub standing_speed: f64,
    /// A battery below this is not driven with, V; 0 does not look.
    pub min_battery: f64,
    /// A battery must be above this to arm, V; 0 does not look.
    pub arm_battery: f64,
    /// More than this part of the frames damaged, either way, stops the car.
    pub max_damaged: f64,
    /// Whether the car is only driven in real time.
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
            require_real_time: false,
        }
    }
}
