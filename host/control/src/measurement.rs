//! Times; places and directions in the world frame, with angles wrapped or continuous; measurements of the
//! car, and the state that is estimated from them.

use core::f64::consts::{PI, TAU};

use libm::{floor, sincos};
use nalgebra::{Point2, Vector2};

/// Nanoseconds on the host's monotonic clock (`CLOCK_MONOTONIC` in the daemon,
/// simulated time elsewhere).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Time(pub u64);

/// Nanoseconds in a second.
const SECOND: f64 = 1e9;

impl Time {
    /// Seconds from `earlier` to this time; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        if self >= earlier {
            (self.0 - earlier.0) as f64 / SECOND
        } else {
            -((earlier.0 - self.0) as f64 / SECOND)
        }
    }

    /// The time `seconds` after this one, rounded down to a nanosecond.
    #[must_use]
    pub fn after(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * SECOND) as u64))
    }

    /// The time `seconds` before this one, but not before the clock's zero.
    #[must_use]
    pub fn before(self, seconds: f64) -> Self {
        Self(self.0.saturating_sub((seconds * SECOND) as u64))
    }
}

/// A position on the floor, world frame, in m.
pub type Position = Point2<f64>;

/// A velocity or displacement on the floor, world frame, in m/s or m.
pub type Velocity = Vector2<f64>;

/// A valid pose of the rigid body, from the motion capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// Mid-exposure, on the host's clock.
    pub capture: Time,
    /// Arrival of the frame, on the host's clock.
    pub receive: Time,
    /// The server's number of the frame.
    pub frame: i32,
    /// Position of the rigid body's origin on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the rigid body, in rad; any multiple of 2π may be added.
    pub yaw: f64,
}

/// A sample of the IMU, in the car's axes. What the car of another program's log does not measure is
/// NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialSample {
    /// When it was measured, on the host's clock.
    pub time: Time,
    /// Angular velocity about the vertical, in rad/s.
    pub yaw_rate: f64,
    /// Acceleration forward, without gravity, in m/s².
    pub forward_acceleration: f64,
    /// Acceleration to the left, without gravity, in m/s².
    pub left_acceleration: f64,
}

/// The motion of the car that the laws measure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Yaw ψ, in rad.
    pub yaw: f64,
    /// Yaw rate r, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip β, in rad.
    pub sideslip: f64,
}

/// The estimated state of the car at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The time of the state.
    pub time: Time,
    /// Position of the centre of mass G, world frame, in m.
    pub position: Position,
    /// Yaw, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip, in rad.
    pub sideslip: f64,
    /// Speed of G, in m/s; negative in reverse.
    pub speed: f64,
    /// Mid-exposure of the last accepted pose.
    pub pose_time: Time,
}

/// Covariances of an estimate: of each the upper triangle, by rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// Covariance of the position of G in the world frame (x and y, in m) and of the yaw (rad).
    pub pose: [f64; 6],
    /// Covariance of the velocity of G forward and to the left (m/s), and of the yaw rate (rad/s).
    pub twist: [f64; 6],
}

impl Estimate {
    /// The part of the state that the laws use.
    pub const fn motion(&self) -> Motion {
        Motion {
            yaw: self.yaw,
            yaw_rate: self.yaw_rate,
            sideslip: self.sideslip,
        }
    }

    /// Age of the last accepted pose at the estimate's time, in s.
    pub fn pose_age(&self) -> f64 {
        self.time.seconds_since(self.pose_time)
    }
}

/// The unit vector at `angle` from the world's x axis, in rad.
pub fn direction(angle: f64) -> Vector2<f64> {
    let (sine, cosine) = sincos(angle);
    Vector2::new(cosine, sine)
}

/// The counter-clockwise angle from `from` to `to`, in (-π, π], in rad.
pub fn angle_between(from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
    libm::atan2(from.perp(to), from.dot(to))
}

/// The angle wrapped to [-π, π), in rad.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    angle - TAU * floor((angle + PI) / TAU)
}

/// The angle nearest to `reference` that differs from `wrapped` by whole turns, in rad.
#[must_use]
pub fn unwrap_near(wrapped: f64, reference: f64) -> f64 {
    reference + wrap(wrapped - reference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapping_keeps_the_direction_and_stays_within_half_a_turn() {
        for turn in -3..=3 {
            for tenth in 0..63 {
                let angle = f64::from(tenth) * 0.1 + f64::from(turn) * TAU;
                let wrapped = wrap(angle);
                assert!((-PI..PI).contains(&wrapped));
                assert!((libm::sin(wrapped) - libm::sin(angle)).abs() < 1e-12);
                assert!((libm::cos(wrapped) - libm::cos(angle)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn unwrapping_follows_a_car_that_turns_more_than_once() {
        let mut yaw = 0.0;
        for step in 0..1000 {
            let truth = 0.05 * f64::from(step);
            yaw = unwrap_near(wrap(truth), yaw);
            assert!((yaw - truth).abs() < 1e-9);
        }
    }
}
