//! `[estimator]`: how pose, IMU and motor speed become a state.

use serde::{Deserialize, Serialize};
use singletrack_control::{EstimatorConfig, MarkerLoss, VehicleParameters};

use super::{ConfigError, check};

/// How the state is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorSection {
    /// What happens to position and yaw while the markers are lost.
    pub marker_loss: MarkerLossKind,
    /// Standard deviation of a pose's coordinate.
    pub position_noise_m: f64,
    /// Standard deviation of a pose's yaw.
    pub yaw_noise_rad: f64,
    /// A pose this far from the prediction is refused.
    pub position_gate_m: f64,
    /// A pose turned this far from the prediction is refused.
    pub yaw_gate_rad: f64,
    /// Noise density of the gyro.
    pub gyro_noise_density_rad_s_per_sqrt_hz: f64,
    /// Random walk of the gyro's bias.
    pub gyro_bias_walk_rad_s2_per_sqrt_hz: f64,
    /// Noise density of the accelerometer, with the car's vibration.
    pub acceleration_noise_density_m_s2_per_sqrt_hz: f64,
    /// Random walk of the accelerometer's bias.
    pub acceleration_bias_walk_m_s3_per_sqrt_hz: f64,
    /// Standard deviation of the motor's speed at standstill.
    pub motor_speed_noise_m_s: f64,
    /// Standard deviation of the motor's speed in proportion to it.
    pub motor_speed_scale_noise: f64,
    /// Standard deviation of the rear axle's sideways speed.
    pub rear_slip_noise_m_s: f64,
    /// How far beyond a pose `hold` predicts, to cover the pose's latency.
    pub prediction_horizon_ms: f64,
}

/// What happens to position and yaw while the markers are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkerLossKind {
    /// They keep their last value.
    Hold,
    /// They are predicted from IMU and motor speed; `coast` in older files.
    #[serde(alias = "coast")]
    DeadReckon,
}

impl Default for EstimatorSection {
    fn default() -> Self {
        // Of the vehicle it takes the lengths, which are not in this section.
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        Self {
            marker_loss: match config.marker_loss {
                MarkerLoss::Hold => MarkerLossKind::Hold,
                MarkerLoss::DeadReckon => MarkerLossKind::DeadReckon,
            },
            position_noise_m: config.position_noise,
            yaw_noise_rad: config.yaw_noise,
            position_gate_m: config.position_gate,
            yaw_gate_rad: config.yaw_gate,
            gyro_noise_density_rad_s_per_sqrt_hz: config.gyro_noise_density,
            gyro_bias_walk_rad_s2_per_sqrt_hz: config.gyro_bias_walk,
            acceleration_noise_density_m_s2_per_sqrt_hz: config.acceleration_noise_density,
            acceleration_bias_walk_m_s3_per_sqrt_hz: config.acceleration_bias_walk,
            motor_speed_noise_m_s: config.motor_speed_noise,
            motor_speed_scale_noise: config.motor_speed_scale_noise,
            rear_slip_noise_m_s: config.rear_slip_noise,
            prediction_horizon_ms: config.prediction_horizon * 1_000.0,
        }
    }
}

impl EstimatorSection {
    /// For the controller of this vehicle; where the markers are is the motion
    /// capture's section.
    pub(super) const fn config(
        &self,
        vehicle: &VehicleParameters,
        marker_offset_m: [f64; 2],
        marker_yaw_rad: f64,
    ) -> EstimatorConfig {
        EstimatorConfig {
            marker_loss: match self.marker_loss {
                MarkerLossKind::Hold => MarkerLoss::Hold,
                MarkerLossKind::DeadReckon => MarkerLoss::DeadReckon,
            },
            marker_offset: marker_offset_m,
            marker_yaw: marker_yaw_rad,
            position_noise: self.position_noise_m,
            yaw_noise: self.yaw_noise_rad,
            position_gate: self.position_gate_m,
            yaw_gate: self.yaw_gate_rad,
            gyro_noise_density: self.gyro_noise_density_rad_s_per_sqrt_hz,
            gyro_bias_walk: self.gyro_bias_walk_rad_s2_per_sqrt_hz,
            acceleration_noise_density: self.acceleration_noise_density_m_s2_per_sqrt_hz,
            acceleration_bias_walk: self.acceleration_bias_walk_m_s3_per_sqrt_hz,
            motor_speed_noise: self.motor_speed_noise_m_s,
            motor_speed_scale_noise: self.motor_speed_scale_noise,
            rear_slip_noise: self.rear_slip_noise_m_s,
            prediction_horizon: self.prediction_horizon_ms / 1_000.0,
            ..EstimatorConfig::for_vehicle(vehicle)
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        for (key, value, highest) in [
            ("estimator.position_noise_m", self.position_noise_m, 0.1),
            ("estimator.yaw_noise_rad", self.yaw_noise_rad, 0.5),
            ("estimator.position_gate_m", self.position_gate_m, 1.0),
            ("estimator.yaw_gate_rad", self.yaw_gate_rad, 3.0),
            (
                "estimator.gyro_noise_density_rad_s_per_sqrt_hz",
                self.gyro_noise_density_rad_s_per_sqrt_hz,
                1.0,
            ),
            (
                "estimator.gyro_bias_walk_rad_s2_per_sqrt_hz",
                self.gyro_bias_walk_rad_s2_per_sqrt_hz,
                1.0,
            ),
            (
                "estimator.acceleration_noise_density_m_s2_per_sqrt_hz",
                self.acceleration_noise_density_m_s2_per_sqrt_hz,
                10.0,
            ),
            (
                "estimator.acceleration_bias_walk_m_s3_per_sqrt_hz",
                self.acceleration_bias_walk_m_s3_per_sqrt_hz,
                10.0,
            ),
            (
                "estimator.motor_speed_noise_m_s",
                self.motor_speed_noise_m_s,
                1.0,
            ),
            (
                "estimator.motor_speed_scale_noise",
                self.motor_speed_scale_noise,
                1.0,
            ),
            (
                "estimator.rear_slip_noise_m_s",
                self.rear_slip_noise_m_s,
                1.0,
            ),
        ] {
            check::positive(key, value, highest)?;
        }
        check::within(
            "estimator.prediction_horizon_ms",
            self.prediction_horizon_ms,
            0.0..=100.0,
        )
    }
}
