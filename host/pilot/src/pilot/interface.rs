//! What the pilot is given and gives: configuration, commands, the result of a tick.

use singletrack_control::words;
use singletrack_control::{
    Actuation, Covariance, Estimate, EstimatorConfig, FrontPointLaw, Governor, GovernorConfig,
    Limits, NeighbourConfig, Position, Reference, ReferencePoint, SafetyFilter, SetpointError,
    SetpointStamp, SlowedBy, Start, Time, TrackingLoop, Velocity,
};

use super::{Compensation, Filtering};
use crate::{
    event::Jog,
    fence::Fence,
    supervisor::{BoardRequest, Mode, Reason, SupervisorConfig},
    tuning::{Tuned, TuningBounds},
    watch::WatchConfig,
};

/// The configuration of a [`Pilot`](crate::Pilot), in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotConfig {
    /// The law, with p and the assumed `l_f`.
    pub law: FrontPointLaw,
    /// The position loop.
    pub tracking: TrackingLoop,
    /// The path of P; its time counts from the first driving tick.
    pub reference: Reference,
    /// Where a drive begins on it.
    pub start: Start,
    /// Makes the reference slower or wider where the car can't follow it; none to follow it as
    /// it is.
    pub governor: Option<GovernorConfig>,
    /// Limits of speed, acceleration and steering.
    pub limits: Limits,
    /// Parameters of the estimator.
    pub estimator: EstimatorConfig,
    /// The limits at which the car slows down or stops.
    pub supervisor: SupervisorConfig,
    /// The limits of plausible sensors and of tick timing.
    pub watch: WatchConfig,
    /// The geofence.
    pub fence: Fence,
    /// The measured deceleration of the car during a stop, m/s². It bounds the braking
    /// distance: a motor at neutral may brake less than `stop_deceleration` commands.
    pub braking: f64,
    /// The commanded deceleration of a stop, m/s².
    pub stop_deceleration: f64,
    /// What is compensated of clocks and actuators.
    pub compensation: Compensation,
    /// The filter between any outer loop and the law, before its first tick; none if what they
    /// want passes as it is.
    pub safety: Option<SafetyFilter>,
    /// What is expected of other rigid bodies; none if the car does not keep apart from them.
    pub neighbours: Option<NeighbourConfig>,
    /// What may be tuned while the pilot runs, and within which bounds; none if nothing may.
    pub tuning: Option<TuningBounds>,
    /// Whether it corrects what it acts on by what is learned while the car drives. The safety
    /// filter rests on the configured steering: with one, this must be false.
    pub learns: bool,
    /// The control period, s.
    pub period: f64,
}

impl PilotConfig {
    /// The governor of the reference, at its start; none where that is off, and for a reference
    /// of which P does not have a position at every time.
    pub fn governor(&self) -> Option<Governor> {
        let governor = self.governor.as_ref()?;
        let is_path = self.reference.at(0.0).position.is_some();
        is_path.then(|| Governor::new(governor.clone()))
    }
}

/// A command to the board, in force until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCommand {
    /// Speed of the rear axle, m/s.
    pub rear_speed: f64,
    /// Steering angle, rad; positive to the left.
    pub steering: f64,
    /// Mid-exposure of the last accepted pose that the command rests on.
    pub pose_time: Time,
    /// Whether the ESC should brake down to the speed, where it can.
    pub brake: bool,
}

/// The result of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// The mode after the tick.
    pub mode: Mode,
    /// Why the car does not drive, or stopped.
    pub reason: Option<Reason>,
    /// The estimated state that the tick acted on; `None` also while neither poses nor the motor
    /// measure it.
    pub estimate: Option<Estimate>,
    /// The covariances of `estimate`.
    pub covariance: Option<Covariance>,
    /// Whether no pose was accepted since the last tick.
    pub held: bool,
    /// Time since the first driving tick, s; `None` outside a drive.
    pub drive_time: Option<f64>,
    /// Wanted position and velocity of P, from the reference.
    pub reference: Option<ReferencePoint>,
    /// Position of P, from the estimate and the commanded steering.
    pub point: Option<Position>,
    /// Wanted velocity of P after the position loop, m/s.
    pub point_velocity: Option<Velocity>,
    /// Speed of G and steering, after the limits.
    pub actuation: Actuation,
    /// Whether the car turns around to a wanted velocity behind it.
    pub turning_round: bool,
    /// How far ahead the state was predicted to which the command belongs, s; `None` if the
    /// actuators are not compensated, and outside a drive.
    pub looked_ahead: Option<f64>,
    /// The path parameter of the reference, s: the time of the drive, unless a governor has
    /// slowed the reference down; `None` outside a drive.
    pub path: Option<f64>,
    /// Why the reference is slowed down, or led beside its path.
    pub slowed_by: Option<SlowedBy>,
    /// The drive command for the board.
    pub command: Option<DriveCommand>,
    /// The pulses for the board, in [`Mode::Jogging`].
    pub jog: Option<Jog>,
    /// The request to the board.
    pub request: Option<BoardRequest>,
    /// Whether the car has proved its configuration in this tick: the first metre showed
    /// no contradiction.
    pub proved: bool,
    /// Whether the configuration counts as proved no longer, since this tick: a contradiction
    /// ended the drive, or the brakes are too weak.
    pub disproved: bool,
    /// The deceleration of the stop that ended in this tick, m/s²; `None` also if motor and cameras
    /// were both lost meanwhile.
    pub braking_measured: Option<f64>,
    /// Why an arm request would be refused now; `None` if it would not, or while a drive is
    /// underway. Unlike `reason`, it never says why the last drive ended.
    pub preflight: Option<Reason>,
    /// The newest set-point from outside that was not refused.
    pub setpoint: Option<SetpointStamp>,
    /// Why a set-point that came in this tick is not obeyed; of several the newest.
    pub setpoint_refused: Option<SetpointRefusal>,
    /// What the safety filter did in this tick.
    pub filtering: Filtering,
    /// The number of ticks of the drive, or of the last one, in which it did anything.
    pub filtered_ticks: u32,
    /// The values in force of what can be tuned; none if nothing can.
    pub tuned: Option<Tuned>,
}

impl Output {
    /// The output of a pilot that has no estimate and commands nothing.
    pub fn neutral(mode: Mode) -> Self {
        Self {
            mode,
            held: true,
            ..Self::default()
        }
    }
}

/// The configuration was not replaced because a drive is underway, in this mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the car drives (mode {0}): disarm it first")]
pub struct Underway(pub Mode);

words! {
    /// Why the pilot does not obey a set-point that reached it.
    pub enum SetpointRefusal {
        /// A value is infinite or not a number.
        NotFinite = 1 "not-finite",
        /// A value is beyond that of any car, or a trajectory is not one.
        OutOfRange = 2 "out-of-range",
        /// It was decided later than the tick.
        Future = 3 "future",
        /// It is older than the time-out, or its trajectory is over.
        Old = 4 "old",
        /// One that was decided later is in force.
        Superseded = 5 "superseded",
        /// Points of the trajectory are missing.
        Incomplete = 6 "incomplete",
        /// The reference in force takes no set-points.
        NotExternal = 7 "not-external",
    }
}

impl From<SetpointError> for SetpointRefusal {
    fn from(error: SetpointError) -> Self {
        match error {
            SetpointError::NotFinite => Self::NotFinite,
            SetpointError::OutOfRange(_) => Self::OutOfRange,
            SetpointError::Future => Self::Future,
            SetpointError::Old => Self::Old,
            SetpointError::Superseded => Self::Superseded,
            SetpointError::Incomplete => Self::Incomplete,
        }
    }
}
