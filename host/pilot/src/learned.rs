//! What is learned of the car while it drives.
//!
//! The pilot corrects by it what it acts on: the estimate that the law is given, and the angle that
//! it commands. It judges by the configured car: every watch, the supervisor and the geofence see
//! the estimate without a correction, and the angle that was sent, as the configuration reads it.

use libm::{atan2, cos, fabs, hypot, sin};
use singletrack_control::{Estimate, Time, Velocity, direction, wrap};

/// Time in which a correction goes from none to its most, s.
const TIME_TO_MOST: f64 = 10.0;

/// What was learned counts for so long, s: a learner that doubts is silent.
const VALID: f64 = 2.0;

/// Below this speed, the direction of motion is that of the wheels, m/s...
const ROLLS_BELOW: f64 = 0.05;
/// ...and from this one on, that of the velocity: as in the estimator.
const MOVES_ABOVE: f64 = 0.15;

/// Corrections: each is the true value less the configured one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Learned {
    /// Angle of the front wheels for that commanded, as a fraction beyond one.
    pub steering_gain: f64,
    /// Angle of the front wheels when straight ones are commanded, rad.
    pub steering_trim: f64,
    /// Delay of the poses' stamps, s.
    pub stamp_offset: f64,
    /// Yaw of the rigid body on the car, rad.
    pub body_yaw: f64,
    /// Position of the rigid body's pivot, forward, m.
    pub pivot_forward: f64,
    /// Position of the rigid body's pivot, to the left, m.
    pub pivot_left: f64,
}

impl Learned {
    /// The most that each correction may be, to either side.
    pub const MOST: Self = Self {
        steering_gain: 0.25,
        steering_trim: 0.06,
        stamp_offset: 0.025,
        body_yaw: 0.03,
        pivot_forward: 0.015,
        pivot_left: 0.015,
    };

    /// The corrections in the order of their declaration.
    pub const fn values(&self) -> [f64; 6] {
        [
            self.steering_gain,
            self.steering_trim,
            self.stamp_offset,
            self.body_yaw,
            self.pivot_forward,
            self.pivot_left,
        ]
    }

    /// These corrections a time `dt` (s) later, on their way to `wanted`: never beyond
    /// [`MOST`](Self::MOST), and not towards what is not finite.
    pub fn towards(&self, wanted: &Self, dt: f64) -> Self {
        let next = |of: fn(&Self) -> f64| {
            let (now, wanted, most) = (of(self), of(wanted), of(&Self::MOST));
            if !wanted.is_finite() {
                return now;
            }
            let change = most * dt / TIME_TO_MOST;
            wanted.clamp(-most, most).clamp(now - change, now + change)
        };
        Self {
            steering_gain: next(|it| it.steering_gain),
            steering_trim: next(|it| it.steering_trim),
            stamp_offset: next(|it| it.stamp_offset),
            body_yaw: next(|it| it.body_yaw),
            pivot_forward: next(|it| it.pivot_forward),
            pivot_left: next(|it| it.pivot_left),
        }
    }

    /// The angle to command (rad) for an angle of the wheels (rad).
    pub fn command(&self, wheels: f64) -> f64 {
        (wheels - self.steering_trim) / (1.0 + self.steering_gain)
    }

    /// The angle of the wheels (rad) for a commanded one (rad).
    pub fn wheels(&self, commanded: f64) -> f64 {
        (1.0 + self.steering_gain) * commanded + self.steering_trim
    }

    /// The state of the car for an estimate with the configured one. Its times stay.
    pub fn corrected(&self, estimate: &Estimate) -> Estimate {
        if *self == Self::default() {
            // To the bit.
            return *estimate;
        }
        let Estimate {
            yaw_rate,
            sideslip,
            speed,
            ..
        } = *estimate;
        // The cameras show the past: the car has moved and turned on since.
        let late = self.stamp_offset;
        let yaw = estimate.yaw + late * yaw_rate - self.body_yaw;
        let moved = late * speed * direction(estimate.yaw + sideslip);
        let ahead = direction(yaw);
        let pivot = self.pivot_forward * ahead + self.pivot_left * Velocity::new(-ahead.y, ahead.x);
        // The velocity is that of another point, in axes that are turned.
        let course = sideslip + self.body_yaw;
        let forward = speed * cos(course) + self.pivot_left * yaw_rate;
        let left = speed * sin(course) - self.pivot_forward * yaw_rate;
        let sign = if forward < 0.0 { -1.0 } else { 1.0 };
        let pace = fabs(speed);
        let weight = ((pace - ROLLS_BELOW) / (MOVES_ABOVE - ROLLS_BELOW)).clamp(0.0, 1.0);
        let moves = atan2(sign * left, sign * forward);
        Estimate {
            position: estimate.position + moved - pivot,
            yaw,
            sideslip: sideslip + weight * wrap(moves - sideslip),
            speed: speed + weight * (sign * hypot(forward, left) - speed),
            ..*estimate
        }
    }
}

/// The corrections in force, and where they go to.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Learning {
    wanted: Option<(Time, Learned)>,
    pub(crate) in_force: Learned,
}

impl Learning {
    /// A learner says what it has learned.
    pub(crate) const fn learned(&mut self, now: Time, learned: Learned) {
        self.wanted = Some((now, learned));
    }

    /// A tick of a drive without a doubt, `dt` (s) after the last one.
    pub(crate) fn advance(&mut self, now: Time, dt: f64) {
        if let Some((since, wanted)) = &self.wanted
            && now.seconds_since(*since) <= VALID
        {
            self.in_force = self.in_force.towards(wanted, dt);
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::Position;

    use super::*;

    fn assert_near(one: f64, other: f64) {
        assert!((one - other).abs() < 1e-9, "{one} is not {other}");
    }

    #[test]
    fn corrections_are_bounded_in_size_and_rate_and_never_not_a_number() {
        let wrong = Learned {
            steering_gain: f64::NAN,
            steering_trim: f64::INFINITY,
            stamp_offset: 1e9,
            body_yaw: -1e9,
            pivot_forward: 0.001,
            pivot_left: f64::MAX,
        };
        let mut learned = Learned::default();
        for _ in 0..3_000 {
            let next = learned.towards(&wrong, 0.01);
            for ((now, next), most) in learned
                .values()
                .into_iter()
                .zip(next.values())
                .zip(Learned::MOST.values())
            {
                assert!(next.abs() <= most && (next - now).abs() <= most * 0.001_001);
            }
            learned = next;
        }
        let reached = Learned {
            stamp_offset: 0.025,
            body_yaw: -0.03,
            pivot_forward: 0.001,
            pivot_left: 0.015,
            ..Learned::default()
        };
        assert_eq!(learned, reached);
    }

    #[test]
    fn a_commanded_angle_turns_the_wheels_to_the_wanted_one() {
        let learned = Learned {
            steering_gain: -0.2,
            steering_trim: 0.05,
            ..Learned::default()
        };
        assert_near(learned.command(0.25), 0.25);
        assert_near(learned.wheels(learned.command(-0.31)), -0.31);
    }

    #[test]
    fn the_state_is_that_of_the_car_whose_body_is_elsewhere_and_shown_late() {
        // On a circle of 1 m about the origin, with a sideslip of 0.1.
        let (rate, at) = (0.8, 0.7);
        let learned = Learned {
            stamp_offset: 0.02,
            body_yaw: 0.01,
            pivot_forward: 0.012,
            pivot_left: -0.007,
            ..Learned::default()
        };
        let truth = |at: f64| {
            let position = Position::from(direction(at));
            (position, at + core::f64::consts::FRAC_PI_2 - 0.1)
        };
        let (position, yaw) = truth(at - 0.02 * rate);
        // What an estimator with the configured car makes of what the cameras show.
        let shown = |yaw: f64| {
            let ahead = direction(yaw);
            0.012 * ahead - 0.007 * Velocity::new(-ahead.y, ahead.x)
        };
        let pivot = shown(yaw);
        let course = direction(yaw + 0.1);
        let velocity = rate * course + rate * Velocity::new(-pivot.y, pivot.x);
        let estimate = Estimate {
            time: Time(1),
            position: position + pivot,
            yaw: yaw + 0.01,
            yaw_rate: rate,
            sideslip: wrap(libm::atan2(velocity.y, velocity.x) - yaw - 0.01),
            speed: velocity.norm(),
            pose_time: Time(1),
        };
        let found = learned.corrected(&estimate);
        let (position, yaw) = truth(at);
        // To the second order of the time.
        assert!((found.position - position).norm() < 3e-4, "{found:?}");
        assert_near(found.yaw, yaw);
        assert_near(found.speed, rate);
        assert_near(found.sideslip, 0.1);
        assert_eq!(Learned::default().corrected(&estimate), estimate);
    }

    #[test]
    fn a_silent_learner_changes_nothing() {
        let mut learning = Learning::default();
        learning.advance(Time(0), 0.01);
        assert_eq!(learning.in_force, Learned::default());
        learning.learned(Time(0), Learned::MOST);
        learning.advance(Time(2_000_000_000), 0.01);
        let reached = learning.in_force;
        assert!(reached.body_yaw > 0.0);
        learning.advance(Time(2_000_000_001), 0.01);
        assert_eq!(learning.in_force, reached);
    }
}
