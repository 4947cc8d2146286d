//! The accelerometer against the speed of the cameras, while a car starts off.

use libm::{copysign, fabs, hypot, sqrt};

use super::steps::Step;

/// The change of speed by which the accelerometer is judged, m/s, and its tolerance, in m/s
/// and as a share.
const ACCELERATED: f64 = 0.18;
const TOLERANCE: (f64, f64) = (0.05, 0.5);
/// The tolerance for the accelerometer's noise, in standard deviations: it is larger on a car that
/// vibrates.
const DEVIATIONS: f64 = 3.0;
/// The change must come within this time, s, or it says nothing: a bias counts for more, and
/// the linear acceleration of some sensors leaks away.
const WITHIN: f64 = 0.5;

/// Compares both at the start of every drive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StartWatch {
    time: f64,
    forward: f64,
    left: f64,
    judged: bool,
    differs: bool,
}

impl StartWatch {
    /// A step of the drive. `variance` is the power of the accelerometer's noise, m²/s⁴/Hz.
    pub(crate) fn step(&mut self, step: &Step, variance: f64) {
        if self.judged {
            return;
        }
        // Backward in reverse, as the motor turns.
        let speed = copysign(step.rear.norm() / step.time, step.motor_way);
        // Over a step the speed is that of its middle; the integral is that of its end.
        let forward = self.forward + 0.5 * step.forward;
        let left = self.left + 0.5 * step.left;
        self.time += step.time;
        self.forward += step.forward;
        self.left += step.left;
        let fast = fabs(speed) >= ACCELERATED;
        self.judged = fast || self.time > WITHIN;
        if fast {
            let (margin, share) = TOLERANCE;
            // A NaN differs.
            let noise = DEVIATIONS * sqrt(variance * self.time);
            let fits = hypot(forward - speed, left) <= margin + share * fabs(speed) + noise;
            self.differs = !fits;
        }
    }

    /// The drive begins with a car that moves: its start says nothing.
    pub(crate) const fn skip(&mut self) {
        self.judged = true;
    }

    /// Whether the start is over.
    pub(crate) const fn is_judged(&self) -> bool {
        self.judged
    }

    /// Whether the accelerometer contradicted the speed.
    pub(crate) const fn differs(&self) -> bool {
        self.differs
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::Velocity;

    use super::*;

    /// A step with its time (s), its speed (m/s), and what the accelerometer measures forward
    /// and to the left (m/s).
    fn step(time: f64, speed: f64, forward: f64, left: f64) -> Step {
        Step {
            time,
            rear: Velocity::new(0.0, speed * time),
            yaw: 0.0,
            turn: 0.0,
            gyro_turn: 0.0,
            forward,
            left,
            steering: 0.0,
            motor_way: speed * time,
        }
    }

    fn after(steps: &[Step]) -> StartWatch {
        let mut watch = StartWatch::default();
        for step in steps {
            watch.step(step, 0.0);
        }
        watch
    }

    #[test]
    fn a_start_is_judged_at_its_speed() {
        assert!(!after(&[]).is_judged());
        assert!(!after(&[step(0.1, 0.179, 0.0, 0.0)]).is_judged());
        assert!(after(&[step(0.1, 0.181, 0.0, 0.0)]).is_judged());
    }

    #[test]
    fn a_slow_start_is_over_after_half_a_second_and_says_nothing() {
        let slow = step(0.25, 0.1, 5.0, 5.0);
        assert!(!after(&[slow]).is_judged());
        assert!(!after(&[slow, slow]).is_judged());
        let watch = after(&[slow, slow, slow]);
        assert!(watch.is_judged() && !watch.differs());
    }

    #[test]
    fn the_accelerometer_may_differ_by_a_margin_and_a_share_of_the_speed() {
        // At 0.3 m/s by 0.2 m/s. The last step counts half.
        for (forward, left, differs) in [
            (0.01, 0.0, false),
            (-0.01, 0.0, true),
            (0.78, 0.0, false),
            (0.82, 0.0, true),
            (0.4, 0.19, false),
            (0.4, 0.21, true),
            (0.4, f64::NAN, true),
            (f64::NAN, 0.0, true),
        ] {
            let part = if left == 0.0 { 0.0 } else { 0.05 };
            let slow = step(0.05, 0.1, 0.05, part);
            let watch = after(&[slow, slow, step(0.1, 0.3, forward, left)]);
            assert!(watch.is_judged());
            assert_eq!(watch.differs(), differs, "{forward} {left}");
        }
    }

    #[test]
    fn the_verdict_stays_until_the_next_drive() {
        let good = step(0.1, 0.3, 0.6, 0.0);
        let bad = step(0.1, 0.3, -0.6, 0.0);
        let mut watch = after(&[bad, good, good]);
        assert!(watch.differs());
        watch = StartWatch::default();
        assert!(!watch.is_judged() && !watch.differs());
        watch.step(&good, 0.0);
        watch.step(&bad, 0.0);
        assert!(watch.is_judged() && !watch.differs());
    }

    #[test]
    fn a_start_in_reverse_is_compared_with_its_sign() {
        let start = |forward: f64| {
            let speeds = [-0.05, -0.1, -0.15, -0.2];
            after(&speeds.map(|speed| step(0.05, speed, forward, 0.0)))
        };
        assert!(start(-0.05).is_judged() && !start(-0.05).differs());
        assert!(start(0.05).differs() && start(0.0).differs());
    }
}
