//! References of a few numbers: a circle (the paper's trajectory tracking test), a figure of eight
//! (turns to both sides, and a crossing), steps of velocity (the paper's open-loop test), and
//! waypoints with times.

use heapless::Vec;
use libm::sincos;

use super::{ReferenceError, ReferencePoint, finite, positive};
use crate::{Position, Velocity, direction};

fn finite_centre(centre: Position) -> Result<Position, ReferenceError> {
    finite("centre_m x", centre.x)?;
    finite("centre_m y", centre.y)?;
    Ok(centre)
}

/// A circle at constant angular velocity, which starts on the x axis of the centre.
///
/// ```
/// use singletrack_control::{Circle, Position, ReferenceError};
///
/// let circle = Circle::new(Position::new(1.0, 2.0), 0.8, 0.5)?;
/// assert_eq!(circle.radius(), 0.8);
/// let flat = Circle::new(Position::origin(), 0.0, 0.5);
/// assert!(matches!(flat, Err(ReferenceError::NotPositive("radius_m", _))));
/// # Ok::<(), ReferenceError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    centre: Position,
    radius: f64,
    pub(super) angular_velocity: f64,
    /// The time on the lap at which the drive begins, s.
    pub(super) phase: f64,
}

impl Circle {
    /// A circle of `radius` (m) about `centre` (m) at `angular_velocity` (rad/s,
    /// counter-clockwise positive).
    ///
    /// # Errors
    ///
    /// The radius must be above zero, all values finite.
    pub fn new(
        centre: Position,
        radius: f64,
        angular_velocity: f64,
    ) -> Result<Self, ReferenceError> {
        Ok(Self {
            centre: finite_centre(centre)?,
            radius: positive("radius_m", radius)?,
            angular_velocity: finite("angular_velocity_rad_s", angular_velocity)?,
            phase: 0.0,
        })
    }

    /// The centre, in m.
    pub const fn centre(&self) -> Position {
        self.centre
    }

    /// The radius, in m.
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// The angular velocity, in rad/s.
    pub const fn angular_velocity(&self) -> f64 {
        self.angular_velocity
    }

    pub(super) fn on_lap(&self, time: f64) -> ReferencePoint {
        let radial = self.radius * direction(self.angular_velocity * time);
        ReferencePoint {
            position: Some(self.centre + radial),
            velocity: self.angular_velocity * nalgebra::Vector2::new(-radial.y, radial.x),
        }
    }
}

/// A Gerono lemniscate: x = a sin(ωt), y = b sin(2ωt), about a centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FigureOfEight {
    centre: Position,
    half_length: f64,
    half_width: f64,
    pub(super) angular_velocity: f64,
    /// The time on the lap at which the drive begins, s.
    pub(super) phase: f64,
}

impl FigureOfEight {
    /// A figure of eight that extends from `centre` by `half_length` (m) along x and by
    /// `half_width` (m) along y, with the period 2π / `angular_velocity` (rad/s).
    ///
    /// # Errors
    ///
    /// Lengths must be above zero, all values finite.
    pub fn new(
        centre: Position,
        half_length: f64,
        half_width: f64,
        angular_velocity: f64,
    ) -> Result<Self, ReferenceError> {
        Ok(Self {
            centre: finite_centre(centre)?,
            half_length: positive("half_length_m", half_length)?,
            half_width: positive("half_width_m", half_width)?,
            angular_velocity: finite("angular_velocity_rad_s", angular_velocity)?,
            phase: 0.0,
        })
    }

    pub(super) fn on_lap(&self, time: f64) -> ReferencePoint {
        let phase = self.angular_velocity * time;
        let (sine, cosine) = sincos(phase);
        let (sine_of_double, cosine_of_double) = sincos(2.0 * phase);
        ReferencePoint {
            position: Some(
                self.centre
                    + Velocity::new(self.half_length * sine, self.half_width * sine_of_double),
            ),
            velocity: self.angular_velocity
                * Velocity::new(
                    self.half_length * cosine,
                    2.0 * self.half_width * cosine_of_double,
                ),
        }
    }
}

/// The largest number of steps in a sequence.
pub const MAX_VELOCITY_STEPS: usize = 64;

/// One constant velocity of P.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityStep {
    /// Its duration, in s.
    pub duration: f64,
    /// The velocity, in m/s.
    pub velocity: Velocity,
}

/// Steps switch this much early, in s: a sum of durations that equals the time of a tick
/// up to rounding then switches at that tick.
const ROUNDING: f64 = 1e-9;

/// A sequence of constant velocities; the last one has no end.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocitySteps {
    /// The end of each step, in s, with its velocity.
    steps: Vec<(f64, Velocity), MAX_VELOCITY_STEPS>,
}

impl VelocitySteps {
    /// The sequence of `steps`. A step starts when the sum of the earlier
    /// durations has passed.
    ///
    /// # Errors
    ///
    /// At least one step, at most [`MAX_VELOCITY_STEPS`]; durations above zero,
    /// velocities finite.
    pub fn new(steps: &[VelocityStep]) -> Result<Self, ReferenceError> {
        if steps.is_empty() {
            return Err(ReferenceError::TooFew("steps", 0, 1));
        }
        let mut end = 0.0;
        let mut sequence = Vec::new();
        for step in steps {
            end += positive("duration_s", step.duration)?;
            finite("v_x_m_s", step.velocity.x)?;
            finite("v_y_m_s", step.velocity.y)?;
            sequence
                .push((end, step.velocity))
                .map_err(|_| ReferenceError::TooMany("steps", MAX_VELOCITY_STEPS))?;
        }
        Ok(Self { steps: sequence })
    }

    /// The end of the last step, in s.
    pub fn duration(&self) -> f64 {
        self.steps.last().map_or(0.0, |step| step.0)
    }

    /// The position at `time` (s) of an ideal integrator that starts at `start`: the
    /// nominal trajectory of P (equation 6).
    pub fn integrate(&self, start: crate::Position, time: f64) -> crate::Position {
        let mut position = start;
        let mut begin = 0.0;
        let last = self.steps.len().saturating_sub(1);
        for (index, (end, velocity)) in self.steps.iter().enumerate() {
            let until = if index == last { time } else { time.min(*end) };
            position += (until - begin).max(0.0) * velocity;
            begin = *end;
        }
        position
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.first(|end| time < end - ROUNDING)
    }

    pub(super) fn before(&self, time: f64) -> ReferencePoint {
        self.first(|end| time <= end + ROUNDING)
    }

    pub(super) fn next_switch(&self, time: f64) -> Option<f64> {
        let [switches @ .., _] = &self.steps[..] else {
            return None;
        };
        let mut ends = switches.iter().map(|step| step.0);
        ends.find(|end| *end > time + ROUNDING)
    }

    /// The first step whose end satisfies a condition, or the last step.
    fn first(&self, condition: impl Fn(f64) -> bool) -> ReferencePoint {
        let step = self.steps.iter().find(|(end, _)| condition(*end));
        let step = step.or(self.steps.last());
        ReferencePoint {
            position: None,
            velocity: step.map_or_else(Velocity::zeros, |step| step.1),
        }
    }
}

/// The largest number of waypoints in a path.
pub const MAX_WAYPOINTS: usize = 1024;

/// A position of P with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Time since the start of the drive, in s.
    pub time: f64,
    /// The position, in m.
    pub position: Position,
}

/// A path through waypoints with straight lines between them; before the time of the first
/// and after that of the last it stands still.
#[derive(Clone, Debug, PartialEq)]
pub struct Waypoints {
    points: Vec<Waypoint, MAX_WAYPOINTS>,
}

impl Waypoints {
    /// The path through `points`.
    ///
    /// # Errors
    ///
    /// At least two points, at most [`MAX_WAYPOINTS`], all finite, in strictly
    /// increasing time.
    pub fn new(points: &[Waypoint]) -> Result<Self, ReferenceError> {
        if points.len() < 2 {
            return Err(ReferenceError::TooFew("waypoints", points.len(), 2));
        }
        let mut previous = f64::NEG_INFINITY;
        for (index, point) in points.iter().enumerate() {
            finite("waypoint t_s", point.time)?;
            finite("waypoint x_m", point.position.x)?;
            finite("waypoint y_m", point.position.y)?;
            if point.time <= previous {
                return Err(ReferenceError::TimeNotIncreasing(index, point.time));
            }
            previous = point.time;
        }
        Ok(Self {
            points: Vec::from_slice(points)
                .map_err(|_| ReferenceError::TooMany("waypoints", MAX_WAYPOINTS))?,
        })
    }

    /// The waypoints, in order.
    pub fn points(&self) -> &[Waypoint] {
        &self.points
    }

    /// The time of the last waypoint, in s.
    pub(super) fn duration(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.time)
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.between(time, self.passed(time))
    }

    /// The number of waypoints until `time`, in s.
    fn passed(&self, time: f64) -> usize {
        self.points.partition_point(|point| point.time <= time)
    }

    pub(super) fn before(&self, time: f64) -> ReferencePoint {
        self.between(time, self.points.partition_point(|point| point.time < time))
    }

    pub(super) fn next_switch(&self, time: f64) -> Option<f64> {
        Some(self.points.get(self.passed(time))?.time)
    }

    /// The reference at `time` (s), between the waypoint `next` and the one before it.
    fn between(&self, time: f64, next: usize) -> ReferencePoint {
        let last = next.checked_sub(1).and_then(|index| self.points.get(index));
        match (last, self.points.get(next)) {
            (Some(from), Some(to)) => {
                let velocity = (to.position - from.position) / (to.time - from.time);
                ReferencePoint {
                    position: Some(from.position + (time - from.time) * velocity),
                    velocity,
                }
            }
            (last, next) => ReferencePoint {
                position: last.or(next).map(|point| point.position),
                velocity: Velocity::zeros(),
            },
        }
    }
}
