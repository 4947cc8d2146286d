//! `[control]`, `[supervisor]` and `[watch]`: how the controller runs, when the car may drive, and when
//! it must stop.

use singletrack_control::InertialSample;
use singletrack_pilot::{SupervisorConfig, WatchConfig};
use singletrack_settings::{Maps as _, section};

section! {
    /// How the controller runs.
    "control" => pub ControlSection: Copy;
    [default];

    // Faster than 200 Hz the commands fill the line; slower than 20 Hz the board's 95 ms
    // leave no room for one that is lost.
    /// Period of the controller.
    @restart period_ms: u32 = 10, in 5..=50;
    /// A frame that arrives up to 3 ms before the deadline of a tick begins it, and the deadlines
    /// slide slowly to keep frames there. Poses are then fresh, and no tick goes without one
    /// because the clocks of cameras and host drift.
    @restart align_to_cameras: bool = true;
    /// Deceleration of a commanded stop.
    stop_deceleration_m_s2: f64 = 2.4, in up_to(50.0);
    /// `SCHED_FIFO` priority of the control thread, if the system grants it (`LimitRTPRIO=`);
    /// 0 does not request it. The threads that read board and cameras have one less.
    @restart realtime_priority: u8 = 40, in 0..=90;
}

impl ControlSection {
    /// The period, in ns.
    pub fn period_ns(&self) -> u64 {
        u64::from(self.period_ms) * 1_000_000
    }
}

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
    pub fn config(&self) -> SupervisorConfig {
        self.apply_to(SupervisorConfig::paper())
    }
}

section! {
    /// Plausibility of the sensors, and tick timing. Beyond these limits the car stops.
    "watch" => pub WatchSection: Copy;
    [maps WatchConfig = WatchConfig::paper()];

    /// An inertial sample with a higher yaw rate is implausible.
    max_yaw_rate_rad_s: f64 => max_yaw_rate, in up_to(35.0);
    /// An inertial sample with a higher acceleration is implausible.
    max_acceleration_m_s2: f64 => max_acceleration, in up_to(160.0);
    /// A higher estimate of the gyro's bias is implausible.
    max_gyro_bias_rad_s: f64 => max_gyro_bias, in up_to(1.0);
    /// Number of implausible inertial samples in a row that stops the car.
    implausible_samples: u32 => implausible_samples, in 1..=100;
    /// Number of inertial samples in a row, equal to the last bit, that stops the car; 0
    /// disables the check.
    stuck_samples: u32 => stuck_samples, in 0..=1_000;
    /// The speeds from the motor pulses and from the cameras may differ by this much, plus a
    /// pulse in 0.2 s...
    speed_margin_m_s: f64 => speed_margin, in up_to(2.0);
    /// ...plus this fraction of the higher one.
    speed_ratio: f64 => speed_ratio, in up_to(0.9);
    /// The car may exceed `limits.max_speed_m_s` by this much.
    overspeed_margin_m_s: f64 => overspeed_margin, in up_to(5.0);
    /// Poses that repeat to the last bit for longer are frozen; 0 disables the check.
    frozen_poses_ms: u32 => frozen_poses, in 0..=2_000;
    /// To arm, the IMU must be tilted by less than this.
    max_tilt_rad: f64 => max_tilt, in up_to(1.5);
    /// To arm, roll and pitch of IMU and cameras may differ by this.
    max_tilt_difference_rad: f64 => max_tilt_difference, in up_to(1.5);
    /// The rear axle may move at this angle to the yaw, plus 0.03 rad per m/s2 of lateral
    /// acceleration, as a mean over 0.25 m.
    max_sideslip_rad: f64 => max_sideslip, in up_to(1.5);
    /// Over 0.4 m, the turn of the car may differ from that of its steering by 0.2 rad plus
    /// this fraction.
    steering_ratio: f64 => steering_ratio, in up_to(5.0);
    /// A higher estimate of the accelerometer's bias is implausible.
    max_acceleration_bias_m_s2: f64 => max_acceleration_bias, in up_to(50.0);
    /// A higher mean of the normalised innovation squared of the poses is inconsistent. Its
    /// expected value is 3.
    max_innovation: f64 => max_innovation, in up_to(1_000_000.0);
    /// The mid-exposure of the poses must be known to this.
    max_capture_uncertainty_ms: f64 = 20.0, in up_to(200.0);
    /// Time between two ticks that stops the car.
    max_gap_ms: u32 => max_gap, in 20..=95;
    /// Number of ticks that may be missed in one second.
    max_missed_ticks_per_s: u32 => max_missed, in 1..=90;
}

impl WatchSection {
    /// Whether the car can move like this: see [`WatchConfig::is_possible`].
    pub fn is_possible(&self, sample: &InertialSample) -> bool {
        self.apply_to(WatchConfig::paper()).is_possible(sample)
    }
}
