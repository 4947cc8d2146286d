//! References: position and velocity of P over time.

mod circle;
mod external;
mod figure_of_eight;
mod path;
mod start;
mod velocity_steps;
mod waypoints;

pub use circle::Circle;
pub use external::External;
pub use figure_of_eight::FigureOfEight;
pub use path::{MAX_PATH_POINTS, Path, PathSpeed};
pub use start::Start;
pub use velocity_steps::{MAX_VELOCITY_STEPS, VelocityStep, VelocitySteps};
pub use waypoints::{MAX_WAYPOINTS, Waypoint, Waypoints};

use crate::{Demand, Position, Time, Velocity};

/// A reference at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePoint {
    /// Position of P, in m; none for a reference of velocity only.
    pub position: Option<Position>,
    /// Velocity of P, in m/s.
    pub velocity: Velocity,
}

/// The longest time for which a car waits for the reference that its P has overtaken, s.
const OVERTAKEN: f64 = 1.0;

impl ReferencePoint {
    /// The velocity of a reference that comes after `point` (m) soon, in m/s: see
    /// [`Ahead::overtaken`](crate::Ahead::overtaken).
    #[must_use]
    pub fn overtaken_by(&self, point: &Position) -> Option<Velocity> {
        let away = (self.position? - point).norm();
        let is_near = away < OVERTAKEN * self.velocity.norm();
        is_near.then_some(self.velocity)
    }
}

/// A reference for P over time.
///
/// ```
/// use singletrack_control::{Circle, Position, Reference, Velocity, VelocityStep, VelocitySteps};
///
/// let circle = Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5)?);
/// let start = circle.at(0.0);
/// assert_eq!(start.position, Some(Position::new(1.0, 0.0)));
/// assert_eq!(start.velocity, Velocity::new(0.0, 0.5));
/// assert_eq!(circle.duration(), None, "it does not end");
///
/// // A reference of velocity alone.
/// let step = VelocityStep { duration: 2.0, velocity: Velocity::new(0.5, 0.0) };
/// let steps = Reference::VelocitySteps(VelocitySteps::new(&[step])?);
/// assert_eq!(steps.at(1.0).position, None);
/// assert_eq!(steps.duration(), Some(2.0));
/// # Ok::<(), singletrack_control::ReferenceError>(())
/// ```
#[expect(
    clippy::large_enum_variant,
    reason = "a controller has one of them, and without an allocator it can't be boxed"
)]
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Reference {
    /// A circle.
    Circle(Circle),
    /// A sequence of constant velocities (the paper's open-loop test).
    VelocitySteps(VelocitySteps),
    /// A Gerono lemniscate.
    FigureOfEight(FigureOfEight),
    /// A path through points with times.
    Waypoints(Waypoints),
    /// A smooth path through points.
    Path(Path),
    /// Set-points that another program sends, [`crate::Setpoint`].
    External(External),
}

/// An invalid parameter of a reference.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// The value must be finite and above zero.
    #[error("{name} is {value}: it must be finite and above zero")]
    NotPositive {
        /// The value's name.
        name: &'static str,
        /// The value.
        value: f64,
    },
    /// The value must be finite.
    #[error("{name} is {value}: it must be finite")]
    NotFinite {
        /// The value's name.
        name: &'static str,
        /// The value.
        value: f64,
    },
    /// The sequence needs more elements.
    #[error("{name}: {count} given, at least {least} needed")]
    TooFew {
        /// The sequence's name.
        name: &'static str,
        /// The number of elements.
        count: usize,
        /// The smallest number of elements.
        least: usize,
    },
    /// The sequence is longer than the capacity of the controller.
    #[error("{name}: more than the {most} that fit")]
    TooMany {
        /// The sequence's name.
        name: &'static str,
        /// The largest number of elements.
        most: usize,
    },
    /// The waypoints must be in order of time.
    #[error("waypoint {index} is at {time_s} s, not after the one before it")]
    TimeNotIncreasing {
        /// Index of the later waypoint, from 0.
        index: usize,
        /// Its time, in s.
        time_s: f64,
    },
    /// Two points of a path in a row are too close for a spline.
    #[error("point {index} is {distance:.4} m from the one before it; at least 0.005 m are needed")]
    TooClose {
        /// Index of the later point, from 0.
        index: usize,
        /// Their distance, in m.
        distance: f64,
    },
    /// The path bends more than any car can follow.
    #[error(
        "the path turns with a radius of {radius:.3} m at point {index}; at least 0.05 m are needed"
    )]
    TooSharp {
        /// Index of the point, from 0.
        index: usize,
        /// The radius, in m.
        radius: f64,
    },
}

impl Reference {
    /// What the reference demands at `now`, `time` seconds after the start of the drive.
    #[must_use]
    pub fn demand(&self, now: Time, time: f64) -> Demand {
        match self {
            Self::External(external) => external.demand(now),
            own => Demand::Point(own.at(time)),
        }
    }

    /// The point that the reference will demand `ahead` seconds after `now`, which is `time`
    /// seconds after the start of the drive; none if it demands steering and speed.
    ///
    /// Of a set-point from outside, no more is known than its velocity.
    #[must_use]
    pub fn point_ahead(&self, now: Time, time: f64, ahead: f64) -> Option<ReferencePoint> {
        match self {
            Self::External(external) => external.point_ahead(now, ahead),
            own => Some(own.at(time + ahead)),
        }
    }

    /// The reference at `time` seconds after the start of the drive; standstill for set-points
    /// from outside, which no one knows beforehand.
    #[must_use]
    pub fn at(&self, time: f64) -> ReferencePoint {
        match self {
            Self::Circle(circle) => circle.at(time),
            Self::VelocitySteps(steps) => steps.at(time),
            Self::FigureOfEight(figure) => figure.at(time),
            Self::Waypoints(waypoints) => waypoints.at(time),
            Self::Path(path) => path.at(time),
            Self::External(_) => ReferencePoint {
                position: None,
                velocity: Velocity::zeros(),
            },
        }
    }

    /// The reference just before `time` (s), which differs from [`Self::at`] where it jumps.
    #[must_use]
    pub fn before(&self, time: f64) -> ReferencePoint {
        match self {
            Self::VelocitySteps(steps) => steps.before(time),
            Self::Waypoints(waypoints) => waypoints.before(time),
            Self::Circle(_) | Self::FigureOfEight(_) | Self::Path(_) | Self::External(_) => {
                self.at(time)
            }
        }
    }

    /// The time at which the reference ends, in s; none if it does not end.
    #[must_use]
    pub fn duration(&self) -> Option<f64> {
        match self {
            Self::Circle(_) | Self::FigureOfEight(_) | Self::External(_) => None,
            Self::VelocitySteps(steps) => Some(steps.duration()),
            Self::Waypoints(waypoints) => Some(waypoints.duration()),
            Self::Path(path) => (!path.is_closed()).then(|| path.lap_time()),
        }
    }

    /// The next time after `time` at which the reference jumps, in s.
    #[must_use]
    pub fn next_switch(&self, time: f64) -> Option<f64> {
        match self {
            Self::Circle(_) | Self::FigureOfEight(_) | Self::Path(_) | Self::External(_) => None,
            Self::VelocitySteps(steps) => steps.next_switch(time),
            Self::Waypoints(waypoints) => waypoints.next_switch(time),
        }
    }
}

/// The value, if it is finite and above zero.
fn positive(name: &'static str, value: f64) -> Result<f64, ReferenceError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(ReferenceError::NotPositive { name, value })
    }
}

/// The value, if it is finite.
fn finite(name: &'static str, value: f64) -> Result<f64, ReferenceError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(ReferenceError::NotFinite { name, value })
    }
}
