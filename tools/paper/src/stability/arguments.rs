//! The options that several subcommands share.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use singletrack_analysis::stability::{Belief, ClosedLoop, Law, SampledLoop, SamplingError, Servo};

use super::{grid::Grid, subject::Subject};
use crate::vehicle_file::{self, VehicleFileError};

/// The car and its law.
#[derive(Clone, Debug, Args)]
pub(super) struct LoopArgs {
    /// The linearising law
    #[arg(long, value_enum)]
    pub(super) law: LawName,
    /// Which distances the law has wrong by dl
    #[arg(long, value_enum, default_value_t = BeliefName::CentreOfMass)]
    pub(super) wrong: BeliefName,
    #[command(flatten)]
    pub(super) car: CarArgs,
}

/// The car and its P.
#[derive(Clone, Debug, Args)]
pub(super) struct CarArgs {
    /// A TOML file with a table [vehicle] [default: the paper's car]
    #[arg(long, value_name = "FILE")]
    pub(super) vehicle: Option<PathBuf>,
    /// Distance p of the point P, in m
    #[arg(long, value_name = "M", default_value_t = 0.35)]
    pub(super) point_distance: f64,
}

/// The laws by name, as in a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum LawName {
    /// The proposed law: P before the front axle
    FrontPoint,
    /// The law of the appendix: P before the centre of mass
    VelocityPoint,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum BeliefName {
    /// The centre of mass: `l_f` + dl and `l_r` - dl, as in the paper
    CentreOfMass,
    /// The front axle alone: `l_f` + dl
    FrontAxle,
}

/// How a result is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// A header and a row for each point
    Csv,
    /// One document, with the car and all values of each point
    Json,
}

impl LoopArgs {
    pub(super) fn subject(&self) -> Result<Subject, VehicleFileError> {
        Ok(Subject {
            vehicle: vehicle_file::read_or_paper(self.car.vehicle.as_deref())?,
            law: match self.law {
                LawName::FrontPoint => Law::FrontPoint,
                LawName::VelocityPoint => Law::VelocityPoint,
            },
            belief: match self.wrong {
                BeliefName::CentreOfMass => Belief::CentreOfMass,
                BeliefName::FrontAxle => Belief::FrontAxle,
            },
            point_distance: self.car.point_distance,
        })
    }
}

/// The speeds of a curve or a map.
#[derive(Clone, Debug, Args)]
pub(super) struct SpeedArgs {
    /// Speeds of the steady motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.1:8:0.05")]
    pub(super) speeds: Grid,
}

/// The points of a map. A subcommand with other defaults changes them with `mut_arg`.
#[derive(Clone, Debug, Args)]
pub(super) struct PointArgs {
    #[command(flatten)]
    speed: SpeedArgs,
    /// Deviations dl of the centre of mass, in m [default: those of the paper's figures]
    #[arg(long, value_name = "A:B:STEP")]
    dl: Option<Grid>,
}

impl PointArgs {
    /// The speeds, in m/s.
    pub(super) fn speeds(&self) -> &Grid {
        &self.speed.speeds
    }

    /// The deviations dl, in m, or the subcommand's own.
    pub(super) fn deviations_or(&self, default: impl FnOnce() -> Grid) -> Grid {
        self.dl.clone().unwrap_or_else(default)
    }
}

/// A map of the steady motion over speed and dl.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("speeds", |speeds| speeds.default_value("0.1:8:0.1")))]
pub(super) struct MapArgs {
    #[command(flatten)]
    pub(super) subject: LoopArgs,
    #[command(flatten)]
    pub(super) points: PointArgs,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    pub(super) format: Format,
}

/// The timing of the sampled loop.
#[derive(Clone, Copy, Debug, Args)]
pub struct TimingArgs {
    /// Period of the controller, in ms
    #[arg(long, value_name = "MS", default_value_t = 10.0)]
    pub period_ms: f64,
    /// From a tick's measurement until its command acts, in ms
    #[arg(long, value_name = "MS", default_value_t = 10.0)]
    pub delay_ms: f64,
    /// Ticks from one seen pose to the next; in between it is held
    #[arg(long, value_name = "TICKS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub marker_interval: u32,
    /// Gain of a proportional position loop around the law, in 1/s; 0 for the law alone
    #[arg(long, value_name = "K", default_value_t = 0.0)]
    pub position_gain: f64,
    /// Lag of the steering servo, in ms; 0 for wheels that follow at once
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub steering_lag_ms: f64,
    /// Dead time of the steering servo, in ms; adds to the delay
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub steering_dead_time_ms: f64,
    /// The law is given the state at which its command acts, predicted by exact models of car
    /// and servo
    #[arg(long)]
    pub predict: bool,
}

impl TimingArgs {
    /// The servo of the simulated car, as the defaults of `[actuators]` have it, and the time
    /// from its tick to the servo's pulse.
    #[must_use]
    pub fn simulated_car() -> Self {
        Self {
            delay_ms: 6.0,
            steering_lag_ms: 40.0,
            steering_dead_time_ms: 12.0,
            ..Self::default()
        }
    }

    /// `closed_loop` with this timing.
    ///
    /// # Errors
    ///
    /// An invalid time or gain.
    pub fn around(&self, closed_loop: ClosedLoop) -> Result<SampledLoop, SamplingError> {
        let dead_time = self.steering_dead_time_ms * 1e-3;
        let has_servo = self.steering_lag_ms != 0.0;
        if self.predict && !has_servo {
            return Err(SamplingError {
                name: "--steering-lag-ms with --predict",
                value: 0.0,
                rule: "above zero: the prediction is of a servo",
            });
        }
        let delay = self.delay_ms * 1e-3 + if has_servo { 0.0 } else { dead_time };
        let mut sampled = SampledLoop::new(closed_loop, self.period_ms * 1e-3, delay)?
            .with_marker_interval(self.marker_interval)
            .with_position_gain(self.position_gain)?;
        if has_servo {
            sampled = sampled.with_servo(Servo {
                lag: self.steering_lag_ms * 1e-3,
                dead_time,
            })?;
        }
        match sampled.exact_prediction() {
            Some(prediction) if self.predict => sampled.with_prediction(prediction),
            _ => Ok(sampled),
        }
    }
}

impl Default for TimingArgs {
    fn default() -> Self {
        Self {
            period_ms: 10.0,
            delay_ms: 10.0,
            marker_interval: 1,
            position_gain: 0.0,
            steering_lag_ms: 0.0,
            steering_dead_time_ms: 0.0,
            predict: false,
        }
    }
}
