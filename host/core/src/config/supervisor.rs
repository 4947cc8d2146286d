//! `[supervisor]`: when the car may drive, and when it must stop.

use singletrack_pilot::SupervisorConfig;
use singletrack_settings::{Maps as _, section};

section! {
    /// When the car may drive, and when it must stop. The age of a pose counts from its
    /// mid-exposure. `docs/safety.md` derives the defaults for lost markers from the
    /// worst case.
    "supervisor" => pub SupervisorSection: Copy;
    [maps SupervisorConfig = SupervisorConfig::paper()];

    /// Markers lost: the last pose is held for this time or `hold_distance_m`, whichever
    /// ends first. Then the car slows down with its wheels held, and drives on if the
    /// markers come back.
    hold_ms: u32 => hold, in 20..=900;
    /// Distance for which the last pose is held.
    hold_distance_m: f64 => hold_distance, in up_to(1.0);
    /// Blind for longer than this or farther than `blind_distance_m`, the car stops, and
    /// must be armed again.
    blind_ms: u32 => blind, in hold_ms..=950;
    /// Longest distance that the car drives blind.
    blind_distance_m: f64 => blind_distance, in hold_distance_m..=2.0;
    /// To arm, and for a slowing car to drive on, a pose must be younger than this.
    fresh_ms: u32 => fresh, in 10..=hold_ms;
    // The estimator bridges 200 ms.
    /// No inertial sample for longer than this stops the car.
    imu_silence_ms: u32 => imu_silence, in 20..=200;
    /// To arm, the yaw rate must have been below this for 0.2 s.
    still_yaw_rate_rad_s: f64 => still_yaw_rate, in up_to(1.0);
    /// To arm, the acceleration must have been below this for 0.2 s.
    still_acceleration_m_s2: f64 => still_acceleration, in up_to(5.0);
    /// Time that the board may take to arm.
    arm_timeout_ms: u32 => arm_timeout, in 50..=5_000;
    /// Number of poses after which the estimate is trusted.
    settling_poses: u32 => settling_poses, in 1..=10_000;
    /// Number of implausible poses in a row that stops the car.
    max_implausible_poses: u32 => max_implausible, in 1..=100;
    /// Slowing down takes at most this long; then the board is disarmed in any case.
    stop_timeout_ms: u32 => stop_timeout, in 100..=1_700;
    /// Below this speed the car counts as standing.
    standing_speed_m_s: f64 => standing_speed, in up_to(0.2);
    /// A lower battery voltage ends a drive, after three reports (0.6 s). The default is for
    /// two lithium cells; 0 disables the check, for a board without a voltage divider.
    min_battery_v: f64 => min_battery, in 0.0..=60.0;
    /// To arm, the battery voltage must be above this; 0 disables the check.
    arm_battery_v: f64 => arm_battery, in min_battery_v..=60.0;
    /// A higher fraction of damaged frames over one second, to the board or from it, stops
    /// the car.
    max_damaged_frames: f64 => max_damaged, in up_to(1.0);
    /// Drives the first metre of a configuration that has not been proved on this car with
    /// 0.3 m/s at most, and compares the sensors; the reference waits for it. A contradiction stops
    /// the car.
    prove_first_metre: bool => prove;
    /// Refuses to arm unless `doctor`, `bring-up` and `calibrate` have passed with this
    /// configuration on this car, within the last 90 days. An `arm` that says `uncalibrated`
    /// is not refused.
    require_calibration: bool = true;
    /// Refuses to drive unless the system grants `SCHED_FIFO` and locked memory.
    require_real_time: bool => require_real_time;
}

impl SupervisorSection {
    /// For the controller.
    #[must_use]
    pub fn config(&self) -> SupervisorConfig {
        self.apply_to(SupervisorConfig::paper())
    }
}
