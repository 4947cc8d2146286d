//! Can the car stop inside? How long the way of a stop is, and where it leads.
//!
//! A stop begins a reaction time t after it is decided, and slows down with the constant
//! deceleration a: from the speed v its way is |v| t + v²/(2a), and so the car can stop within a
//! way s from a (√(t² + 2s/a) - t). A stop holds the wheels: a car that rolls goes along one bend,
//! whose curvature is κ. After a part w of the way its course has turned by κ w, and the chord to
//! there is w sin(κw/2)/(κw/2) long and lies half of that turn beside the first course. The path
//! is looked at half way and at its end: it lies at most κ w²/32 beside the chords of both halves.
//!
//! Four ask, each with a speed and a bend of its own:
//!
//! | who asks | speed, bend | what follows if it can't |
//! |---|---|---|
//! | feasibility, before a drive | those of an ideal car | the drive does not begin |
//! | the [`Governor`](crate::Governor), ahead | those of the leader on the reference | the reference is slowed down |
//! | the [`SafetyFilter`](crate::SafetyFilter), each tick | every one that is possible: `ways.rs` bounds them all | the command is limited |
//! | the geofence's watch, each tick | the measured and the commanded | the car stops |

mod ways;

use core::f64::consts::FRAC_PI_2;

use libm::{fabs, sincos, sqrt};

pub(crate) use ways::{ROUNDED, Range, StopWay, Wheels};

use crate::Velocity;

/// How the car stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// The time before it slows down, s.
    pub reaction: f64,
    /// The deceleration then, m/s².
    pub braking: f64,
}

impl Stop {
    /// The way to standstill from a speed in either direction (m/s), in m.
    pub const fn way(&self, speed: f64) -> f64 {
        let pace = speed.abs();
        pace * self.reaction + 0.5 * pace * pace / self.braking
    }

    /// The speed from which the car stands within a way of `way` m, in m/s; 0 if that is NaN or
    /// negative.
    pub fn fastest(&self, way: f64) -> f64 {
        if way.is_nan() || way <= 0.0 {
            return 0.0;
        }
        let Self { reaction, braking } = *self;
        braking * (sqrt(reaction * reaction + 2.0 * way / braking) - reaction)
    }
}

/// Where a way of `way` m along a bend (1/m, positive to the left) leads, in m: half of it and all
/// of it. `course` is the unit vector of the motion, for a negative way that of the motion forward.
pub fn along_bend(course: &Velocity, curvature: f64, way: f64) -> [Velocity; 2] {
    [0.5 * way, way].map(|way| {
        // Beyond half of a circle it comes back.
        let turn = (0.5 * curvature * way).clamp(-FRAC_PI_2, FRAC_PI_2);
        let (sine, cosine) = sincos(turn);
        let turned = Velocity::new(
            cosine * course.x - sine * course.y,
            sine * course.x + cosine * course.y,
        );
        let part = if fabs(turn) < 1e-6 { 1.0 } else { sine / turn };
        way * (part * turned)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direction;

    const STOP: Stop = Stop {
        reaction: 0.1,
        braking: 1.5,
    };

    #[test]
    fn the_fastest_speed_of_a_way_is_that_whose_way_it_is() {
        for speed in [0.01, 0.4, 3.0] {
            assert!((STOP.fastest(STOP.way(speed)) - speed).abs() < 1e-12);
            assert_eq!(STOP.way(-speed), STOP.way(speed));
        }
        for way in [f64::NAN, -1.0, 0.0] {
            assert_eq!(STOP.fastest(way), 0.0);
        }
    }

    #[test]
    fn a_way_along_a_bend_ends_on_its_circle() {
        let course = direction(0.3);
        for (curvature, way) in [
            (0.5, 1.0),
            (-2.0, 0.7),
            (1e-9, 1.0),
            (0.0, 1.0),
            (2.0, -0.4),
        ] {
            let [half, whole] = along_bend(&course, curvature, way);
            let straight = way * course;
            if curvature.abs() < 1e-6 {
                assert!((half - 0.5 * straight).norm() + (whole - straight).norm() < 1e-8);
                continue;
            }
            let centre = Velocity::new(-course.y, course.x) / curvature;
            for place in [half, whole] {
                let radius = (place - centre).norm();
                assert!((radius - 1.0 / curvature.abs()).abs() < 1e-12);
            }
            let turned = (course.perp(&(whole - half))).signum();
            assert_eq!(turned, curvature.signum());
        }
    }
}
