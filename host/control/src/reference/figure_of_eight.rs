//! A figure of eight: turns to both sides, and a crossing.

use libm::sincos;

use super::{ReferenceError, ReferencePoint, finite, positive};
use crate::{Position, Velocity};

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
            centre: Position::new(
                finite("centre_m x", centre.x)?,
                finite("centre_m y", centre.y)?,
            ),
            half_length: positive("half_length_m", half_length)?,
            half_width: positive("half_width_m", half_width)?,
            angular_velocity: finite("angular_velocity_rad_s", angular_velocity)?,
            phase: 0.0,
        })
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.on_lap(self.phase + time)
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
