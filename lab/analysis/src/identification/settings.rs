//! The choices of an identification, and the noise levels of the sensors and of the road: how they are
//! measured.

use core::array::from_fn;

use singletrack_control::{GRAVITY, SlipAngles, Tyres, VehicleParameters, words, wrap};

use super::{
    data::{
        Channel, DriveData, Inertial, MEDIAN_OF_NORMAL, Pose, ServoFrames, Span, are_at, median,
    },
    parameter::Parameter,
};

words! {
    /// What a fit minimises.
    pub enum Criterion {
        /// The errors of the prediction of each sample from those before it: the most exact, if the
        /// model is right.
        Prediction = "prediction",
        /// The errors of the model alone, without a correction since the stretch began: what a
        /// simulation of the car needs, and robust against behaviour that the model lacks.
        Simulation = "simulation",
    }
}

/// The parameters, model and noise levels of an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The parameters to estimate. The others keep their start values, those of
    /// [`Parameter::NUISANCE`] included.
    pub parameters: Vec<Parameter>,
    /// The force curve of the tyres.
    pub tyres: Tyres,
    /// The slip angles of the model.
    pub slip_angles: SlipAngles,
    /// Dead time and lag of the steering (s) where the fit starts, and about which their priors are; none
    /// for those of [`Values::of`](super::Values::of).
    pub steering: Option<[f64; 2]>,
    /// The board's periods that begin a servo pulse; none to estimate them.
    pub frames: Option<ServoFrames>,
    /// Noise levels, or their start values if they are estimated.
    pub noise: NoiseLevels,
    /// Estimates the noise levels too.
    pub estimate_noise: bool,
    /// What is minimised; none for the prediction, and for the simulation where forces that the model does
    /// not explain make the prediction's parameters simulate much worse.
    pub criterion: Option<Criterion>,
    /// The smallest speed that is used, in m/s: at lower speeds the tyres hardly slip.
    pub least_speed: f64,
}

impl Default for Settings {
    /// The paper's three parameters and those that must be estimated jointly with them.
    fn default() -> Self {
        Self::of(&Parameter::VEHICLE)
    }
}

impl Settings {
    /// These parameters and [`Parameter::NUISANCE`], which must be estimated jointly.
    pub fn of(parameters: &[Parameter]) -> Self {
        let mut all = Vec::new();
        for parameter in parameters.iter().chain(&Parameter::NUISANCE) {
            if !all.contains(parameter) {
                all.push(*parameter);
            }
        }
        Self {
            parameters: all,
            tyres: Tyres::default(),
            slip_angles: SlipAngles::default(),
            steering: None,
            frames: None,
            noise: NoiseLevels::usual(),
            estimate_noise: true,
            criterion: None,
            least_speed: 0.5,
        }
    }
}

/// Standard deviations of measurement and process noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLevels {
    /// Noise of each coordinate of a pose, in m.
    pub position_m: f64,
    /// Noise of the yaw of a pose, in rad.
    pub yaw_rad: f64,
    /// Noise of a sample of the gyro, in rad/s.
    pub yaw_rate_rad_s: f64,
    /// Noise of a sample of the acceleration to the left, in m/s².
    pub left_m_s2: f64,
    /// Density of the noise of the acceleration forward, in m/s²/√Hz.
    pub forward_density: f64,
    /// Density of the unmodelled force on each axle, in N/√Hz.
    pub force_density: f64,
    /// Random walk of the gyro's bias, in rad/s/√s.
    pub gyro_walk: f64,
    /// Random walk of the bias of the acceleration forward, in m/s²/√s.
    pub forward_walk: f64,
}

/// The smallest force density on an axle, which the filter needs, in N/√Hz.
pub(super) const LEAST_FORCE: f64 = 1e-6;

/// The least standard deviations that the fit believes of a sensor. Samples that are held, rounded or
/// smoothed by the sensor have third differences of nearly zero; with levels as small as that, the filter
/// would trust single samples to the last digit.
const LEAST: NoiseLevels = NoiseLevels {
    position_m: 5e-5,
    yaw_rad: 3e-4,
    yaw_rate_rad_s: 1e-3,
    left_m_s2: 0.02,
    ..NoiseLevels::exact()
};

impl NoiseLevels {
    /// Start values of their estimation: a good motion capture system, and a consumer IMU on
    /// a vibrating car.
    pub const fn usual() -> Self {
        Self {
            position_m: 3e-4,
            yaw_rad: 2e-3,
            yaw_rate_rad_s: 5e-3,
            left_m_s2: 0.1,
            forward_density: 0.02,
            force_density: 3e-3,
            gyro_walk: 1e-4,
            forward_walk: 2e-3,
        }
    }

    /// Levels with which the filter follows the sensors, whatever the car: a bad IMU on a bad floor, and a
    /// model that explains little.
    pub(super) fn loose(vehicle: &VehicleParameters) -> Self {
        Self {
            position_m: 1e-3,
            yaw_rad: 3e-3,
            yaw_rate_rad_s: 0.05,
            left_m_s2: 1.0,
            forward_density: 0.3,
            force_density: 0.02 * vehicle.mass_kg * GRAVITY,
            gyro_walk: 1e-4,
            forward_walk: 0.05,
        }
    }

    /// Nearly exact sensors and model, as the base of other levels. The filter needs every
    /// level to be above zero.
    pub const fn exact() -> Self {
        Self {
            position_m: 1e-6,
            yaw_rad: 1e-6,
            yaw_rate_rad_s: 1e-6,
            left_m_s2: 1e-6,
            forward_density: 1e-6,
            force_density: LEAST_FORCE,
            gyro_walk: 1e-9,
            forward_walk: 1e-9,
        }
    }

    /// The standard deviation of a sample of `channel`.
    pub(super) const fn of(&self, channel: Channel) -> f64 {
        match channel {
            Channel::X | Channel::Y => self.position_m,
            Channel::Yaw => self.yaw_rad,
            Channel::YawRate => self.yaw_rate_rad_s,
            Channel::Left => self.left_m_s2,
        }
    }

    /// These levels, with those of the sensors by `level`, from the channels of a sensor and its level.
    pub(super) fn with_sensors(self, level: impl Fn(&[Channel], f64) -> f64) -> Self {
        Self {
            position_m: level(&[Channel::X, Channel::Y], self.position_m),
            yaw_rad: level(&[Channel::Yaw], self.yaw_rad),
            yaw_rate_rad_s: level(&[Channel::YawRate], self.yaw_rate_rad_s),
            left_m_s2: level(&[Channel::Left], self.left_m_s2),
            ..self
        }
    }

    /// These levels, with those of the sensors from third differences of the samples.
    ///
    /// Independent of the model: the car's motion has small third differences.
    pub(super) fn with_measured_sensors(self, data: &DriveData, spans: &[Span]) -> Self {
        let poses = |values: fn(&[Pose]) -> [f64; 4]| {
            differences(&data.poses, |pose| are_at(spans, pose.time_s), values)
        };
        let inertial = |value: fn(&Inertial) -> f64| {
            let values = |four: &[Inertial]| from_fn(|index| value(&four[index]));
            differences(&data.inertial, |one| are_at(spans, one.time_s), values)
        };
        let of_channel = |channel: &Channel| match channel {
            Channel::X => poses(|four| from_fn(|index| four[index].x_m)),
            Channel::Y => poses(|four| from_fn(|index| four[index].y_m)),
            Channel::Yaw => {
                poses(|four| from_fn(|index| wrap(four[index].yaw_rad - four[0].yaw_rad)))
            }
            Channel::YawRate => inertial(|sample| sample.yaw_rate_rad_s),
            Channel::Left => inertial(|sample| sample.left_m_s2),
        };
        self.with_sensors(|channels, usual| {
            let measured = deviation(channels.iter().flat_map(of_channel).collect());
            measured.map_or(usual, |measured| measured.max(LEAST.of(channels[0])))
        })
    }
}

/// The magnitudes of the third differences of samples within the stretches, without those of what is
/// not measured; of white noise they have twenty times the variance.
fn differences<T>(
    samples: &[T],
    is_within: impl Fn(&T) -> bool,
    values: impl Fn(&[T]) -> [f64; 4],
) -> Vec<f64> {
    let windows = samples.windows(4);
    let windows = windows.filter(|four| four.iter().all(&is_within));
    let differences = windows.map(|four| {
        let [a, b, c, d] = values(four);
        (d - 3.0 * c + 3.0 * b - a).abs()
    });
    differences.filter(|one| !one.is_nan()).collect()
}

/// Standard deviation of white noise with these third differences, from their median, which
/// is robust against jolts. None if there are too few, or if most are zero.
fn deviation(differences: Vec<f64>) -> Option<f64> {
    let are_enough = differences.len() >= 100;
    let median = median(differences)?;
    (median > 0.0 && are_enough).then(|| median / (MEDIAN_OF_NORMAL * 20_f64.sqrt()))
}
