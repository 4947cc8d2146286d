//! A path through points with times, at constant velocity between them.

use heapless::Vec;

use super::{ReferenceError, ReferencePoint, finite};
use crate::{Position, Velocity};

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
            return Err(ReferenceError::TooFew {
                name: "waypoints",
                count: points.len(),
                least: 2,
            });
        }
        let mut previous = f64::NEG_INFINITY;
        for (index, point) in points.iter().enumerate() {
            finite("waypoint t_s", point.time)?;
            finite("waypoint x_m", point.position.x)?;
            finite("waypoint y_m", point.position.y)?;
            if point.time <= previous {
                return Err(ReferenceError::TimeNotIncreasing {
                    index,
                    time_s: point.time,
                });
            }
            previous = point.time;
        }
        Ok(Self {
            points: Vec::from_slice(points).map_err(|_| ReferenceError::TooMany {
                name: "waypoints",
                most: MAX_WAYPOINTS,
            })?,
        })
    }

    /// The waypoints, in order.
    #[must_use]
    pub fn points(&self) -> &[Waypoint] {
        &self.points
    }

    /// The time of the last waypoint, in s.
    pub(super) fn duration(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.time)
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.between(
            time,
            self.points.partition_point(|point| point.time <= time),
        )
    }

    pub(super) fn before(&self, time: f64) -> ReferencePoint {
        self.between(time, self.points.partition_point(|point| point.time < time))
    }

    pub(super) fn next_switch(&self, time: f64) -> Option<f64> {
        self.points
            .get(self.points.partition_point(|point| point.time <= time))
            .map(|point| point.time)
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
            (Some(point), None) | (None, Some(point)) => ReferencePoint {
                position: Some(point.position),
                velocity: Velocity::zeros(),
            },
            (None, None) => ReferencePoint {
                position: None,
                velocity: Velocity::zeros(),
            },
        }
    }
}
