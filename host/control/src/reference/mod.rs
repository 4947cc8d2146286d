//! References: position and velocity of P over time, and where on a closed one a drive begins.

mod external;
mod path;
mod simple;

use core::{array, f64::consts::TAU};

use libm::fabs;

use crate::{Demand, Position, Time, Velocity, direction, words};

pub use external::External;
pub use path::{MAX_PATH_POINTS, Path, PathSpeed};
pub use simple::{
    Circle, FigureOfEight, MAX_VELOCITY_STEPS, MAX_WAYPOINTS, VelocityStep, VelocitySteps,
    Waypoint, Waypoints,
};

/// A reference at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// A value, by its name, must be finite and above zero.
    #[error("{0} is {1}: it must be finite and above zero")]
    NotPositive(&'static str, f64),
    /// A value, by its name, must be finite.
    #[error("{0} is {1}: it must be finite")]
    NotFinite(&'static str, f64),
    /// A sequence, by its name, needs more elements: how many it has, and the smallest number.
    #[error("{0}: {1} given, at least {2} needed")]
    TooFew(&'static str, usize, usize),
    /// A sequence, by its name, has more elements than the capacity of the controller.
    #[error("{0}: more than the {1} that fit")]
    TooMany(&'static str, usize),
    /// A waypoint, by its index from 0, and its time in s: they must be in order of time.
    #[error("waypoint {0} is at {1} s, not after the one before it")]
    TimeNotIncreasing(usize, f64),
    /// A point of a path, by its index from 0, and its distance in m from the one before it, too
    /// small for a spline.
    #[error("point {0} is {1:.4} m from the one before it; at least 0.005 m are needed")]
    TooClose(usize, f64),
    /// A point, by its index from 0, and the radius there in m: no car can follow such a path.
    #[error("the path turns with a radius of {1:.3} m at point {0}; at least 0.05 m are needed")]
    TooSharp(usize, f64),
}

impl Reference {
    /// What the reference demands at `now`, `time` seconds after the start of the drive.
    pub fn demand(&self, now: Time, time: f64) -> Demand {
        match self {
            Self::External(external) => external.demand(now),
            own => Demand::Point(own.at(time)),
        }
    }

    /// The point that the reference will demand `ahead` seconds after `now`, which is `time`
    /// seconds after the start of the drive; none if it demands steering and speed.
    ///
    /// A set-point from outside has no more than its velocity.
    pub fn point_ahead(&self, now: Time, time: f64, ahead: f64) -> Option<ReferencePoint> {
        match self {
            Self::External(external) => external.point_ahead(now, ahead),
            own => Some(own.at(time + ahead)),
        }
    }

    /// The reference at `time` seconds after the start of the drive; standstill for set-points
    /// from outside, which no one knows beforehand.
    pub fn at(&self, time: f64) -> ReferencePoint {
        match self {
            Self::Circle(circle) => circle.on_lap(circle.phase + time),
            Self::VelocitySteps(steps) => steps.at(time),
            Self::FigureOfEight(figure) => figure.on_lap(figure.phase + time),
            Self::Waypoints(waypoints) => waypoints.at(time),
            Self::Path(path) => path.at(time),
            Self::External(_) => ReferencePoint::default(),
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
    pub fn duration(&self) -> Option<f64> {
        match self {
            Self::Circle(_) | Self::FigureOfEight(_) | Self::External(_) => None,
            Self::VelocitySteps(steps) => Some(steps.duration()),
            Self::Waypoints(waypoints) => Some(waypoints.duration()),
            Self::Path(path) => (!path.is_closed()).then(|| path.lap_time()),
        }
    }

    /// The next time after `time` at which the reference jumps, in s.
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
        Err(ReferenceError::NotPositive(name, value))
    }
}

/// The value, if it is finite.
fn finite(name: &'static str, value: f64) -> Result<f64, ReferenceError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(ReferenceError::NotFinite(name, value))
    }
}

words! {
    /// Where a reference begins.
    pub enum Start: serde {
        /// At the place of a closed path that is nearest to P.
        Nearest = "nearest",
        /// At its beginning.
        Beginning = "beginning",
    }
}

/// The places of a lap that are compared.
const PLACES: usize = 256;

/// How often the span around the nearest of them is narrowed, by a third each.
const NARROWINGS: usize = 40;

/// Up to this cosine of the angle between car and direction of travel, only the distance counts:
/// a car in a narrow bend does not look along the path of P.
const ALONG: f64 = 0.5;

/// What the cosine of a larger angle counts, in m²: a right angle is as bad as half a metre.
const ACROSS_M2: f64 = 0.5;

/// How far the place is from P, in m², and more where the path leads another way than the car
/// looks.
fn remoteness(place: &ReferencePoint, point: &Position, heading: &Velocity) -> f64 {
    let away = place
        .position
        .map_or(0.0, |position| (position - point).norm_squared());
    let along = place.velocity.dot(heading) / place.velocity.norm();
    away + ACROSS_M2 * (ALONG - along).max(0.0)
}

impl Reference {
    /// Begins a drive of a car with P at `point` (m) that looks along `yaw` (rad): time zero of a
    /// closed reference is at its nearest place from now on, or at its beginning. An open one
    /// always begins at its beginning.
    ///
    /// Where two branches are near, the one counts that leads where the car looks.
    ///
    /// ```
    /// use singletrack_control::{Circle, Position, Reference, Start};
    ///
    /// let mut circle = Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5)?);
    /// circle.begin(Start::Nearest, &Position::new(0.0, 1.2), 3.0);
    /// let place = circle.at(0.0).position.unwrap_or_default();
    /// assert!((place - Position::new(0.0, 1.0)).norm() < 1e-6);
    /// # Ok::<(), singletrack_control::ReferenceError>(())
    /// ```
    pub fn begin(&mut self, start: Start, point: &Position, yaw: f64) {
        let phase = match start {
            Start::Nearest => self.nearest(point, yaw),
            Start::Beginning => 0.0,
        };
        match self {
            Self::Circle(circle) => circle.phase = phase,
            Self::FigureOfEight(figure) => figure.phase = phase,
            Self::Path(path) => path.phase = phase,
            Self::VelocitySteps(_) | Self::Waypoints(_) | Self::External(_) => {}
        }
    }

    /// The time on the lap at the place that is nearest to a car there, in s; zero without a lap.
    fn nearest(&self, point: &Position, yaw: f64) -> f64 {
        let Some(lap) = self.lap_time() else {
            return 0.0;
        };
        let heading = direction(yaw);
        let remoteness = |time: f64| remoteness(&self.on_lap(time), point, &heading);
        let step = lap / PLACES as f64;
        let places: [f64; PLACES] = array::from_fn(|index| remoteness(step * index as f64));
        let mut nearest = (f64::INFINITY, 0.0);
        for (index, &here) in places.iter().enumerate() {
            let beside = |by: usize| places.get((index + by) % PLACES).copied().unwrap_or(here);
            // Every place that is nearer than its neighbours, so that no branch is missed.
            if here > beside(PLACES - 1) || here >= beside(1) {
                continue;
            }
            let (mut low, mut high) = (step * (index as f64 - 1.0), step * (index as f64 + 1.0));
            for _ in 0..NARROWINGS {
                let third = (high - low) / 3.0;
                if remoteness(low + third) < remoteness(high - third) {
                    high -= third;
                } else {
                    low += third;
                }
            }
            let time = 0.5 * (low + high);
            let found = remoteness(time);
            if found < nearest.0 {
                nearest = (found, time);
            }
        }
        nearest.1
    }

    /// The time of a closed reference once round, in s; none for an open one.
    pub fn lap_time(&self) -> Option<f64> {
        match self {
            Self::Circle(circle) => turn_time(circle.angular_velocity),
            Self::FigureOfEight(figure) => turn_time(figure.angular_velocity),
            Self::Path(path) => path.is_closed().then(|| path.lap_time()),
            Self::VelocitySteps(_) | Self::Waypoints(_) | Self::External(_) => None,
        }
    }

    /// The place on the lap, wherever the drive has begun.
    fn on_lap(&self, time: f64) -> ReferencePoint {
        match self {
            Self::Circle(circle) => circle.on_lap(time),
            Self::FigureOfEight(figure) => figure.on_lap(time),
            Self::Path(path) => path.on_lap(time),
            Self::VelocitySteps(_) | Self::Waypoints(_) | Self::External(_) => self.at(time),
        }
    }
}

/// The time of a turn, in s; none if it stands still.
fn turn_time(angular_velocity: f64) -> Option<f64> {
    let time = TAU / fabs(angular_velocity);
    time.is_finite().then_some(time)
}
