//! The figures of a drive, each as in the paper's experimental section or about
//! how the controller ran.

mod histogram;
mod time;

use clap::ValueEnum;
use singletrack_control::words;

use super::drive::Drive;
use crate::figure::Figure;

/// What the shading of every figure means.
const LOST: &str = "markers lost";

words! {
    /// A figure of a drive, with its name on the command line and of its file; in the order of a
    /// report.
    #[derive(ValueEnum)]
    pub enum FigureKind {
        /// Nominal and actual path of P.
        Trajectory = "trajectory",
        /// Distance of P from where it should be.
        TrackingError = "tracking-error",
        /// x and y of P over time.
        Position = "position",
        /// The velocity commanded of P.
        CommandedVelocity = "commanded-velocity",
        /// The steering angle that the law asks for.
        Steering = "steering",
        /// The speed that the law asks for, and the car's.
        Speed = "speed",
        /// Sideslip angle and yaw rate.
        SideslipYawRate = "sideslip-yaw-rate",
        /// From mid-exposure to the command that rests on it.
        Latency = "latency",
        /// How late ticks began.
        Lateness = "lateness",
    }
}

impl FigureKind {
    /// The figures of a drive: all, without the lateness if it is always zero.
    pub fn of(drive: &Drive) -> impl Iterator<Item = Self> {
        let is_never_late = drive.is_never_late();
        let has = move |kind: &Self| *kind != Self::Lateness || !is_never_late;
        Self::ALL.into_iter().filter(has)
    }

    /// The name of its file.
    pub fn file_name(self) -> String {
        format!("{}.svg", self.name())
    }

    /// The figure of a drive.
    ///
    /// # Errors
    ///
    /// What the drive lacks for it.
    pub fn draw(self, drive: &Drive) -> Result<Figure, &'static str> {
        let figure = match self {
            Self::Trajectory => time::trajectory(drive),
            Self::Position => time::position(drive),
            Self::CommandedVelocity => time::commanded_velocity(drive),
            Self::Steering => time::steering(drive),
            Self::Speed => time::speed(drive),
            Self::SideslipYawRate => time::sideslip_and_yaw_rate(drive),
            Self::TrackingError => time::tracking_error(drive),
            Self::Latency => histogram::latency(drive),
            Self::Lateness => histogram::lateness(drive),
        };
        // The reference alone is not what it is about.
        let needs_point = matches!(self, Self::Trajectory | Self::Position);
        let has_point = drive.ticks.iter().any(|tick| tick.point[0].is_finite());
        let is_empty = figure.panels.iter().all(crate::figure::Panel::is_empty);
        if !is_empty && (has_point || !needs_point) {
            return Ok(figure);
        }
        Err(match self {
            Self::Trajectory | Self::Position => "no tick knows where P was",
            Self::CommandedVelocity => "no tick commands a velocity of P",
            Self::Steering => "no tick has a steering angle",
            Self::Speed => "no tick has a speed",
            Self::SideslipYawRate => "no tick has an estimate of the state",
            Self::TrackingError => "no tick knows both where P was and where it should be",
            Self::Latency => "no command rests on a new pose and was written",
            Self::Lateness => "there are no ticks",
        })
    }
}
