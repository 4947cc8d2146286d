//! Points, directions and angles in the world frame; angles wrapped or continuous.

use core::f64::consts::{PI, TAU};

use libm::{floor, sincos};
use nalgebra::{Point2, Vector2};

use crate::{FrontPointLaw, Motion};

/// A position on the floor, world frame, in m.
pub type Position = Point2<f64>;

/// A velocity or displacement on the floor, world frame, in m/s or m.
pub type Velocity = Vector2<f64>;

/// The unit vector at `angle` from the world's x axis, in rad.
pub fn direction(angle: f64) -> Vector2<f64> {
    let (sine, cosine) = sincos(angle);
    Vector2::new(cosine, sine)
}

/// Equation 3: the point P, `point_distance` ahead of the front axle in the direction of
/// the front wheels. The front axle is `front_axle_distance` (`l_f`, true or estimated)
/// ahead of G. Angles are in rad, distances in m.
pub fn front_point(
    centre_of_mass: Position,
    yaw: f64,
    steering: f64,
    front_axle_distance: f64,
    point_distance: f64,
) -> Position {
    centre_of_mass
        + front_axle_distance * direction(yaw)
        + point_distance * direction(yaw + steering)
}

/// Equation 4: the velocity of the point P of [`front_point`], in m/s, when G moves with `speed`
/// (m/s) and the steering angle changes with `steering_rate` (rad/s).
pub fn front_point_velocity(
    law: &FrontPointLaw,
    motion: &Motion,
    steering: f64,
    speed: f64,
    steering_rate: f64,
) -> Velocity {
    let left = |angle: f64| {
        let (sine, cosine) = sincos(angle);
        Velocity::new(-sine, cosine)
    };
    let turn_of_wheels = motion.yaw_rate + steering_rate;
    speed * direction(motion.yaw + motion.sideslip)
        + law.front_axle_distance() * motion.yaw_rate * left(motion.yaw)
        + law.point_distance() * turn_of_wheels * left(motion.yaw + steering)
}

/// The appendix: the point P, `point_distance` (m) ahead of G in the direction of the
/// velocity of G. Angles are in rad.
pub fn velocity_point(
    centre_of_mass: Position,
    yaw: f64,
    sideslip: f64,
    point_distance: f64,
) -> Position {
    centre_of_mass + point_distance * direction(yaw + sideslip)
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
