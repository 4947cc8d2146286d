//! Where on a closed reference a drive begins.

use core::array;
use core::f64::consts::TAU;

use libm::fabs;
use singletrack_words::words;

use super::{Reference, ReferencePoint};
use crate::{Position, Velocity, direction};

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
    #[must_use]
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
