//! `[watch]`: plausibility of the sensors, and tick timing.

use singletrack_control::InertialSample;
use singletrack_pilot::WatchConfig;
use singletrack_settings::{Maps as _, section};

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
    #[must_use]
    pub fn is_possible(&self, sample: &InertialSample) -> bool {
        self.apply_to(WatchConfig::paper()).is_possible(sample)
    }
}
