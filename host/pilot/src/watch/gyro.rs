//! The turn of the car by its gyro, and by the cameras.

use heapless::HistoryBuf;
use libm::{copysign, fabs};

use super::steps::Step;

/// Sums both turns over spans in which the cameras see one beyond their noise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turns {
    span: Span,
    /// Turn of the cameras, without its signs, and of the gyro with it, rad.
    pub(super) seen: f64,
    pub(super) felt: f64,
}

/// The turn of some steps.
#[derive(Clone, Copy, Debug, Default)]
struct Span {
    time: f64,
    turn: f64,
    gyro_turn: f64,
}

impl Turns {
    /// A step, with the time of a span (s) and the turn (rad) that is noise in it.
    pub(super) fn step(&mut self, step: &Step, time: f64, noise: f64) {
        self.span.time += step.time;
        self.span.turn += step.turn;
        self.span.gyro_turn += step.gyro_turn;
        if self.span.time >= time {
            let span = core::mem::take(&mut self.span);
            if fabs(span.turn) > noise {
                self.seen += fabs(span.turn);
                self.felt += copysign(1.0, span.turn) * span.gyro_turn;
            }
        }
    }
}

/// Whether the gyro turns to the other side than the cameras, in every drive: one that has been
/// remounted since the configuration was proved.
#[derive(Clone, Debug, Default)]
pub(crate) struct GyroWatch {
    /// The last steps: time (s), turns by cameras and gyro (rad).
    steps: HistoryBuf<[f64; 3], STEPS>,
    opposite: bool,
}

/// The number of steps in which a slow turn is seen.
const STEPS: usize = 8;
/// The shortest time of a comparison, s: two steps.
const SPAN: f64 = 0.09;
/// The turn of a comparison, rad: cameras that shake see none of this size.
const COMPARED: f64 = 0.04;
/// The share of the turn that the gyro must have made to the other side: noise alone makes
/// none to either.
const OPPOSITE: f64 = -0.3;

impl GyroWatch {
    /// A step of a drive. The newest steps in which the cameras see a turn are compared, each
    /// time anew: those before a fault must not hide those after it.
    pub(crate) fn step(&mut self, step: &Step) {
        self.steps.write([step.time, step.turn, step.gyro_turn]);
        let [mut time, mut turn, mut gyro_turn] = [0.0; 3];
        for [step_time, step_turn, step_gyro_turn] in self.steps.oldest_ordered().rev() {
            time += step_time;
            turn += step_turn;
            gyro_turn += step_gyro_turn;
            if time >= SPAN && fabs(turn) > COMPARED {
                self.opposite |= copysign(1.0, turn) * gyro_turn < OPPOSITE * fabs(turn);
                break;
            }
        }
    }

    /// Whether it has turned to the other side in this drive.
    pub(crate) const fn is_opposite(&self) -> bool {
        self.opposite
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::Velocity;

    use super::*;

    fn step(time: f64, turn: f64, gyro_turn: f64) -> Step {
        Step {
            time,
            rear: Velocity::zeros(),
            yaw: 0.0,
            turn,
            gyro_turn,
            forward: 0.0,
            left: 0.0,
            steering: 0.0,
            motor_way: 0.0,
        }
    }

    #[test]
    fn turns_are_compared_over_spans_with_one_beyond_noise() {
        let mut turns = Turns::default();
        for (time, turn, gyro_turn) in [(0.1, 0.01, 0.011), (0.099, 0.02, 0.022)] {
            turns.step(&step(time, turn, gyro_turn), 0.2, 0.015);
        }
        assert_eq!((turns.seen, turns.felt), (0.0, 0.0));
        let mut turns = Turns::default();
        for (time, turn, gyro_turn) in [
            (0.15, 0.01, 0.011),
            (0.15, 0.02, 0.022),
            // The other way round, and what is too little.
            (0.3, -0.02, -0.021),
            (0.3, 0.015, 0.1),
            (0.3, -0.015, 0.1),
        ] {
            turns.step(&step(time, turn, gyro_turn), 0.2, 0.015);
        }
        assert!((turns.seen - 0.05).abs() < 1e-12, "{}", turns.seen);
        assert!((turns.felt - 0.054).abs() < 1e-12, "{}", turns.felt);
    }

    /// The turn after which a gyro with this gain is found, on a bend of 0.4 rad/s.
    fn found_after(gain: f64) -> Option<f64> {
        let mut watch = GyroWatch::default();
        (1..=200)
            .find(|_| {
                watch.step(&step(0.05, 0.02, 0.02 * gain));
                watch.is_opposite()
            })
            .map(|steps| 0.02 * f64::from(steps))
    }

    #[test]
    fn a_gyro_that_is_reversed_is_found_within_a_tenth_of_a_radian() {
        for gain in [-2.0, -1.0, -0.4] {
            let turn = found_after(gain).unwrap();
            assert!(turn < 0.1, "{gain}: {turn}");
        }
        for gain in [-0.2, 0.0, 0.5, 1.0, 2.0] {
            assert_eq!(found_after(gain), None, "{gain}");
        }
    }

    #[test]
    fn a_gyro_that_fails_on_a_bend_is_found_within_a_fifth_of_a_second() {
        // Nothing in the agreement before it hides the fault, wherever it begins.
        for before in 0..20 {
            let mut watch = GyroWatch::default();
            for _ in 0..before {
                watch.step(&step(0.05, -0.02, -0.019));
                assert!(!watch.is_opposite());
            }
            // A bias of 1 rad/s, while the bend is entered.
            let found = [-0.001, -0.02, -0.025, -0.03].map(|turn| {
                watch.step(&step(0.05, turn, turn + 0.05));
                watch.is_opposite()
            });
            assert!(found[3], "{before}: {found:?}");
        }
    }

    #[test]
    fn a_slow_turn_is_compared_over_eight_steps() {
        let mut watch = GyroWatch::default();
        let found = [-0.006; 8].map(|gyro_turn| {
            watch.step(&step(0.05, 0.006, gyro_turn));
            watch.is_opposite()
        });
        assert_eq!(found.iter().position(|found| *found), Some(6));
    }

    #[test]
    fn a_drive_whose_turn_is_noise_shows_nothing() {
        let mut watch = GyroWatch::default();
        for index in 0..10_000 {
            let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
            // A bias of 0.05 rad/s beside cameras with a noise of 25 mrad.
            watch.step(&step(0.1, sign * 0.025, 0.005));
        }
        assert!(!watch.is_opposite());
    }

    #[test]
    fn the_next_drive_begins_anew() {
        let mut watch = GyroWatch::default();
        while !watch.is_opposite() {
            watch.step(&step(0.1, 0.05, -0.05));
        }
        watch = GyroWatch::default();
        assert!(!watch.is_opposite());
    }
}
