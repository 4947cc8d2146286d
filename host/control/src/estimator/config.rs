//! The estimator's parameters.

use singletrack_words::words;

use crate::vehicle::VehicleParameters;

words! {
    /// What the estimator does during a marker loss.
    #[derive(Default)]
    pub enum MarkerLoss: serde {
        /// Position and yaw keep their last value, as in the paper; yaw rate, sideslip and
        /// speed are still estimated.
        #[default]
        Hold = "hold",
        /// Position and yaw are predicted from IMU and motor speed; `coast` in older files.
        DeadReckon = "dead-reckon" or "coast",
    }
}

/// The estimator's parameters, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfig {
    /// What to do during a marker loss.
    pub marker_loss: MarkerLoss,
    /// Position of the rigid body's origin relative to G, in the car's axes (forward,
    /// left), m.
    pub marker_offset: [f64; 2],
    /// Yaw of the rigid body when the car's yaw is zero, rad.
    pub marker_yaw: f64,
    /// Distance from G to the rear axle, m.
    pub rear_axle_distance: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
    /// Standard deviation of a pose's coordinate, m.
    pub position_noise: f64,
    /// Standard deviation of a pose's yaw, rad.
    pub yaw_noise: f64,
    /// Innovation gate: a pose is rejected if it differs from the prediction by more than
    /// this beyond five standard deviations, m; position and yaw together, as an ellipsoid.
    pub position_gate: f64,
    /// The innovation gate of yaw, rad.
    pub yaw_gate: f64,
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Standard deviation of the gyro's scale from one, before anything is measured: 0 takes it
    /// for exact.
    pub gyro_scale_noise: f64,
    /// Random walk of the gyro bias, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer noise density of a car at rest, m/s²/√Hz.
    pub acceleration_noise_density: f64,
    /// What the car's vibration adds to it per speed, m/s²/√Hz per m/s.
    pub vibration_noise_density: f64,
    /// Random walk of the accelerometer bias, m/s³/√Hz.
    pub acceleration_bias_walk: f64,
    /// Standard deviation of the speed from the motor pulses at standstill, m/s.
    pub motor_speed_noise: f64,
    /// Standard deviation of that speed per speed: the tyre radius is not exact.
    pub motor_speed_scale_noise: f64,
    /// Standard deviation of the rear axle's sideways speed, m/s...
    pub rear_slip_noise: f64,
    /// ...and of the angle at which its tyres slip, per lateral acceleration, rad per m/s².
    pub rear_slip_compliance: f64,
    /// The longest prediction of position and yaw from the last pose's mid-exposure under
    /// [`MarkerLoss::Hold`], s. It compensates the latency of a pose, and ends when one is
    /// missing.
    pub prediction_horizon: f64,
}

impl EstimatorConfig {
    /// The power of the accelerometer's noise at a squared speed (m²/s²), m²/s⁴/Hz.
    #[must_use]
    pub const fn acceleration_variance(&self, squared_speed: f64) -> f64 {
        let (rest, vibration) = (
            self.acceleration_noise_density,
            self.vibration_noise_density,
        );
        rest * rest + vibration * vibration * squared_speed
    }

    /// For a motion capture with deviations of 0.2 mm and 0.1 degrees, and a consumer IMU on a car
    /// that vibrates.
    ///
    /// The noise of the IMU is the least with which the running mean of the innovations of a real
    /// car of 1:18, whose IMU sends ten samples a second, stays at a quarter of
    /// `watch.max_innovation` (docs/real-logs.md). A car that is quieter is estimated as well: the
    /// cameras outweigh the IMU sooner.
    #[must_use]
    pub const fn for_vehicle(vehicle: &VehicleParameters) -> Self {
        Self {
            marker_loss: MarkerLoss::Hold,
            marker_offset: [0.0, 0.0],
            marker_yaw: 0.0,
            rear_axle_distance: vehicle.rear_axle_distance_m,
            wheelbase: vehicle.wheelbase_m(),
            position_noise: 2e-4,
            yaw_noise: 1.7e-3,
            position_gate: 0.05,
            yaw_gate: 0.15,
            gyro_noise_density: 5e-3,
            gyro_scale_noise: 0.03,
            gyro_bias_walk: 1e-4,
            acceleration_noise_density: 0.05,
            vibration_noise_density: 0.1,
            acceleration_bias_walk: 2e-3,
            motor_speed_noise: 0.02,
            motor_speed_scale_noise: 0.05,
            rear_slip_noise: 0.05,
            rear_slip_compliance: 0.1,
            prediction_horizon: 0.03,
        }
    }
}
