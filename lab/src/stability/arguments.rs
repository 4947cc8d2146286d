//! The options that several subcommands share.

use std::path::PathBuf;

use clap::{Args, Parser, ValueEnum};
use singletrack_analysis::stability::{
    Ages, Belief, ClosedLoop, Compensation, Law, SampledLoop, SamplingError, Saturation, Servo,
    Timing,
};

use super::subject::{Format, Grid, Subject};
use crate::{
    Result,
    identify::{SlipAngleKind, TyreKind},
    vehicle_file,
};

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

/// How a result that has a figure is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum DrawnFormat {
    /// A header and a row for each point
    Csv,
    /// One document, with the car and all values of each point
    Json,
    /// A figure
    Svg,
}

impl CarArgs {
    /// The car under a law with a wrong centre of mass.
    pub(super) fn under(&self, law: Law) -> Result<Subject> {
        Ok(Subject {
            vehicle: vehicle_file::read_or_paper(self.vehicle.as_deref())?,
            law,
            belief: Belief::CentreOfMass,
            point_distance: self.point_distance,
        })
    }
}

impl LoopArgs {
    pub(super) fn subject(&self) -> Result<Subject> {
        let law = match self.law {
            LawName::FrontPoint => Law::FrontPoint,
            LawName::VelocityPoint => Law::VelocityPoint,
        };
        let belief = match self.wrong {
            BeliefName::CentreOfMass => Belief::CentreOfMass,
            BeliefName::FrontAxle => Belief::FrontAxle,
        };
        Ok(Subject {
            belief,
            ..self.car.under(law)?
        })
    }
}

/// The points of a map. A subcommand with other defaults changes them with `mut_arg`.
#[derive(Clone, Debug, Args)]
pub(super) struct PointArgs {
    /// Speeds of the steady motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.1:8:0.05")]
    pub(super) speeds: Grid,
    /// Deviations dl of the centre of mass, in m [default: those of the paper's figures]
    #[arg(long, value_name = "A:B:STEP")]
    dl: Option<Grid>,
}

impl PointArgs {
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

/// What bounds large motions.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct SaturationArgs {
    /// The tyres; those that saturate have the vehicle's friction
    #[arg(long, value_enum, default_value_t = TyreKind::Linear)]
    tyres: TyreKind,
    /// Slip angles for small angles, as in the paper, or exact ones
    #[arg(long, value_enum, default_value_t = SlipAngleKind::Small)]
    slip_angles: SlipAngleKind,
    /// Steering stop, in rad [default: none]
    #[arg(long, value_name = "RAD", default_value_t = f64::INFINITY, hide_default_value = true)]
    max_steering: f64,
    /// Largest steering rate of the front-point law, in rad/s [default: none]
    #[arg(long, value_name = "RAD_S", default_value_t = f64::INFINITY, hide_default_value = true)]
    max_steering_rate: f64,
}

impl SaturationArgs {
    pub(super) fn saturation(self) -> Saturation {
        Saturation {
            tyres: self.tyres.tyres(),
            slip_angles: self.slip_angles.angles(),
            max_steering: self.max_steering,
            max_steering_rate: self.max_steering_rate,
        }
    }
}

/// The timing of the sampled loop.
#[derive(Clone, Copy, Debug, Parser)]
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
    /// Age of the yaw rate at its tick, in ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub yaw_rate_age_ms: f64,
    /// Age of the sideslip at its tick, in ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    pub sideslip_age_ms: f64,
    /// Ticks for which a pose is predicted after the one that saw it, before it is held
    #[arg(long, value_name = "TICKS", default_value_t = 0)]
    pub predicted_ticks: u32,
    /// Ticks from one pulse of the servo to the next; in between the wheels keep theirs
    #[arg(long, value_name = "TICKS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub servo_frame: u32,
    /// The pilot's compensation: its own prediction, and the lead of its steering
    #[arg(long, conflicts_with = "predict")]
    pub compensate: bool,
    /// With --compensate: dead time from a tick to the wheels as modelled, in ms
    #[arg(long, value_name = "MS", default_value_t = 18.0)]
    pub modelled_dead_time_ms: f64,
}

impl TimingArgs {
    /// The timing of the simulated car; each is a mean over the phases between the clocks of
    /// cameras, inertial sensor and board.
    ///
    /// A command is 2 ms on the line and waits 5 ms for a servo pulse, one every 20 ms, which the
    /// servo answers 2 ms later. The last sample of the yaw rate is 15 ms old; the
    /// estimator goes on from there by the steering that was sent, and what it gives acts as one of
    /// 5 ms: with that the limit cycles of the simulated car begin where the linear loop says, and without
    /// compensation a little later. A pose 8 ms old is predicted up to an age of 30 ms.
    pub fn simulated_car() -> Self {
        Self {
            delay_ms: 7.0,
            steering_lag_ms: 40.0,
            steering_dead_time_ms: 2.0,
            servo_frame: 2,
            yaw_rate_age_ms: 5.0,
            predicted_ticks: 2,
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
        let lag = self.steering_lag_ms * 1e-3;
        let has_servo = self.steering_lag_ms != 0.0;
        if (self.predict || self.compensate) && !has_servo {
            return Err(SamplingError {
                name: "--steering-lag-ms with --predict or --compensate",
                value: 0.0,
                rule: "above zero: the prediction is of a servo",
            });
        }
        let delay = self.delay_ms * 1e-3 + if has_servo { 0.0 } else { dead_time };
        let modelled = Servo {
            lag,
            dead_time: self.modelled_dead_time_ms * 1e-3,
        };
        let vehicle = closed_loop.vehicle();
        let mut timing = Timing {
            marker_interval: self.marker_interval,
            predicted_pose: self.predicted_ticks,
            position_gain: self.position_gain,
            servo: has_servo.then_some(Servo { lag, dead_time }),
            servo_frame: self.servo_frame,
            ages: Ages {
                yaw_rate: self.yaw_rate_age_ms * 1e-3,
                sideslip: self.sideslip_age_ms * 1e-3,
            },
            compensation: self.compensate.then_some(Compensation {
                servo: modelled,
                vehicle,
            }),
            ..Timing::new(self.period_ms * 1e-3, delay)
        };
        if self.predict {
            timing.prediction = timing.exact_prediction(vehicle);
        }
        SampledLoop::new(closed_loop, timing)
    }
}

impl Default for TimingArgs {
    fn default() -> Self {
        Self::parse_from([""])
    }
}
