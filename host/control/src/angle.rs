//! Wrapped and continuous angles.

use core::f64::consts::{PI, TAU};

use libm::floor;

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
