//! `[estimator]` and `[online_calibration]`: how pose, IMU and motor speed become a state, and what a
//! drive says about the calibration.

use singletrack_control::{EstimatorConfig, MarkerLoss, VehicleParameters};
use singletrack_settings::{Declared as _, Maps as _, section};
use singletrack_words::words;

use super::{Config, ConfigError};

section! {
    /// How the state is estimated from pose, IMU and motor speed.
    "estimator" => pub EstimatorSection: Copy;
    // The lengths of the vehicle are not in this section.
    [maps EstimatorConfig = EstimatorConfig::for_vehicle(&VehicleParameters::paper())];

    /// Position and yaw while the markers are lost: "hold" keeps the last pose (as in the
    /// paper), "dead-reckon" predicts it from IMU and motor speed.
    marker_loss: MarkerLoss => marker_loss, words MarkerLoss;
    /// Standard deviation of a pose's coordinate.
    position_noise_m: f64 => position_noise, in up_to(0.1);
    /// Standard deviation of a pose's yaw.
    yaw_noise_rad: f64 => yaw_noise, in up_to(0.5);
    /// A pose farther from the prediction than this, beyond five deviations, is refused.
    position_gate_m: f64 => position_gate, in up_to(1.0);
    /// A pose whose yaw differs more than this from the prediction, beyond five deviations, is
    /// refused.
    yaw_gate_rad: f64 => yaw_gate, in up_to(3.0);
    /// Noise density of the gyro.
    gyro_noise_density_rad_s_per_sqrt_hz: f64 => gyro_noise_density, in up_to(1.0);
    /// Standard deviation of the gyro's scale from one, at the start; 0 takes it for exact.
    gyro_scale_noise: f64 => gyro_scale_noise, in 0.0..=0.1;
    /// Random walk of the gyro's bias.
    gyro_bias_walk_rad_s2_per_sqrt_hz: f64 => gyro_bias_walk, in up_to(1.0);
    /// Noise density of the accelerometer at rest.
    acceleration_noise_density_m_s2_per_sqrt_hz: f64 => acceleration_noise_density,
        in up_to(10.0);
    /// What the car's vibration adds to it, per m/s of its speed.
    vibration_noise_density_m_s2_per_sqrt_hz_per_m_s: f64 => vibration_noise_density, in 0.0..=10.0;
    /// Random walk of the accelerometer's bias.
    acceleration_bias_walk_m_s3_per_sqrt_hz: f64 => acceleration_bias_walk, in up_to(10.0);
    /// Standard deviation of the motor's speed at standstill.
    motor_speed_noise_m_s: f64 => motor_speed_noise, in up_to(1.0);
    /// Standard deviation of the motor's speed, as a fraction of it.
    motor_speed_scale_noise: f64 => motor_speed_scale_noise, in up_to(1.0);
    /// Standard deviation of the rear axle's lateral speed.
    rear_slip_noise_m_s: f64 => rear_slip_noise, in up_to(1.0);
    /// Standard deviation of the angle at which its tyres slip, per lateral acceleration.
    rear_slip_compliance_rad_per_m_s2: f64 => rear_slip_compliance, in 0.0..=1.0;
    /// How far beyond a pose "hold" predicts, to cover the pose's latency.
    prediction_horizon_ms: f64 = 30.0, in 0.0..=100.0;
}

impl EstimatorSection {
    /// For the controller of this vehicle; where the markers are is in `[motion_capture]`.
    pub(super) fn config(
        &self,
        vehicle: &VehicleParameters,
        marker_offset_m: [f64; 2],
        marker_yaw_rad: f64,
    ) -> EstimatorConfig {
        self.apply_to(EstimatorConfig {
            prediction_horizon: self.prediction_horizon_ms / 1_000.0,
            marker_offset: marker_offset_m,
            marker_yaw: marker_yaw_rad,
            ..EstimatorConfig::for_vehicle(vehicle)
        })
    }
}

words! {
    /// What becomes of the estimates.
    pub enum OnlineCalibrationMode: serde {
        /// Nothing is estimated.
        Off = "off",
        /// The estimates are shown.
        Advice = "advice",
        /// The controller corrects what it acts on by them, too.
        Live = "live",
    }
}

section! {
    /// Estimates how steering, cameras, IMU and motor sensor differ from their configuration, while
    /// the car drives. `docs/online-calibration.md` says what the estimates are worth.
    "online_calibration" => pub OnlineCalibrationSection: Copy;
    [default];

    /// "off"; "advice": status and log say what is off; or "live": the controller corrects what it
    /// acts on, within bounds, and begins every drive without a correction. "live" excludes the
    /// safety filter.
    mode: OnlineCalibrationMode = OnlineCalibrationMode::Off, text "\"off\", \"advice\" or \"live\"";
}

impl OnlineCalibrationSection {
    /// Refuses live calibration with the safety filter, which rests on the configured steering.
    pub(super) fn validate(self, config: &Config) -> Result<(), ConfigError> {
        if self.mode == OnlineCalibrationMode::Live && config.safety_filter.enabled {
            return Err(ConfigError::value(
                "online_calibration.mode",
                "\"live\"",
                "the safety filter rests on the configured steering; use \"advice\", or set \
                 safety_filter.enabled = false",
            ));
        }
        Ok(self.check()?)
    }

    /// Whether anything is estimated.
    #[must_use]
    pub fn is_enabled(self) -> bool {
        self.mode != OnlineCalibrationMode::Off
    }
}
