//! A circle: the paper's trajectory tracking test.

use super::{ReferenceError, ReferencePoint, finite, positive};
use crate::{Position, direction};

/// A circle at constant angular velocity, which starts on the x axis of the centre.
///
/// ```
/// use singletrack_control::{Circle, Position, ReferenceError};
///
/// let circle = Circle::new(Position::new(1.0, 2.0), 0.8, 0.5)?;
/// assert_eq!(circle.radius(), 0.8);
/// let flat = Circle::new(Position::origin(), 0.0, 0.5);
/// assert!(matches!(flat, Err(ReferenceError::NotPositive { name: "radius_m", .. })));
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
            centre: Position::new(
                finite("centre_m x", centre.x)?,
                finite("centre_m y", centre.y)?,
            ),
            radius: positive("radius_m", radius)?,
            angular_velocity: finite("angular_velocity_rad_s", angular_velocity)?,
            phase: 0.0,
        })
    }

    /// The centre, in m.
    #[must_use]
    pub const fn centre(&self) -> Position {
        self.centre
    }

    /// The radius, in m.
    #[must_use]
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// The angular velocity, in rad/s.
    #[must_use]
    pub const fn angular_velocity(&self) -> f64 {
        self.angular_velocity
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.on_lap(self.phase + time)
    }

    pub(super) fn on_lap(&self, time: f64) -> ReferencePoint {
        let radial = self.radius * direction(self.angular_velocity * time);
        ReferencePoint {
            position: Some(self.centre + radial),
            velocity: self.angular_velocity * nalgebra::Vector2::new(-radial.y, radial.x),
        }
    }
}
