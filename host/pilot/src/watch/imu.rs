//! Plausibility and stillness of the inertial samples; the turn of the car by its gyro and by the
//! cameras; and the accelerometer against the speed of the cameras, while a car starts off.

use heapless::HistoryBuf;
use libm::{copysign, fabs, hypot, sqrt};
use singletrack_control::InertialSample;

use super::{WatchConfig, count, steps::Step};

/// Whether the inertial samples are plausible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImuVerdict {
    /// Within range and changing.
    #[default]
    Good,
    /// Too many samples in a row, or the gyro bias, are out of range.
    Implausible,
    /// Samples repeat to the last bit. A working sensor has noise.
    Stuck,
}

/// Counts implausible, equal and still inertial samples in a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ImuWatch {
    last: Option<InertialSample>,
    impossible: u32,
    equal: u32,
    still: u32,
}

/// The number of still samples in a row after which the car is still: 0.2 s at 100 Hz.
const STILL_SAMPLES: u32 = 20;

impl ImuWatch {
    /// A new sample. Below both limits, for yaw rate (rad/s) and acceleration (m/s²), it
    /// counts as still.
    pub(crate) fn handle(
        &mut self,
        sample: &InertialSample,
        config: &WatchConfig,
        (still_yaw_rate, still_acceleration): (f64, f64),
    ) {
        count(&mut self.impossible, !config.is_possible(sample));
        let equal = self.last.is_some_and(|last| {
            last.yaw_rate == sample.yaw_rate
                && last.forward_acceleration == sample.forward_acceleration
                && last.left_acceleration == sample.left_acceleration
        });
        count(&mut self.equal, equal);
        self.last = Some(*sample);
        // What is not possible says nothing of the car's motion either.
        if !config.is_possible(sample) {
            return;
        }
        let acceleration = hypot(sample.forward_acceleration, sample.left_acceleration);
        let still = fabs(sample.yaw_rate) < still_yaw_rate && acceleration < still_acceleration;
        count(&mut self.still, still);
    }

    /// The verdict on the samples so far and the estimated gyro bias (rad/s).
    pub(crate) fn verdict(&self, gyro_bias: f64, config: &WatchConfig) -> ImuVerdict {
        if config.stuck_samples > 0 && self.equal >= config.stuck_samples {
            ImuVerdict::Stuck
        } else if self.impossible >= config.implausible_samples
            || fabs(gyro_bias) > config.max_gyro_bias
        {
            ImuVerdict::Implausible
        } else {
            ImuVerdict::Good
        }
    }

    /// Whether the last [`STILL_SAMPLES`] samples were still.
    pub(crate) const fn is_still(&self) -> bool {
        self.still >= STILL_SAMPLES
    }
}

/// Sums both turns over spans in which the cameras see one beyond their noise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turns {
    span: TurnSpan,
    /// Turn of the cameras, without its signs, and of the gyro with it, rad.
    pub(super) seen: f64,
    pub(super) felt: f64,
}

/// The turn of some steps.
#[derive(Clone, Copy, Debug, Default)]
struct TurnSpan {
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
    /// Whether it has turned to the other side in this drive.
    pub(crate) is_opposite: bool,
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
    /// A step of a drive. Each time, the newest steps in which the cameras see a turn are
    /// compared: steps from before a fault must not hide those after it.
    pub(crate) fn step(&mut self, step: &Step) {
        self.steps.write([step.time, step.turn, step.gyro_turn]);
        let [mut time, mut turn, mut gyro_turn] = [0.0; 3];
        for [step_time, step_turn, step_gyro_turn] in self.steps.oldest_ordered().rev() {
            time += step_time;
            turn += step_turn;
            gyro_turn += step_gyro_turn;
            if time >= SPAN && fabs(turn) > COMPARED {
                self.is_opposite |= copysign(1.0, turn) * gyro_turn < OPPOSITE * fabs(turn);
                break;
            }
        }
    }
}

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
    /// Whether the start is over; a drive that begins with a car that moves has none.
    pub(crate) is_judged: bool,
    /// Whether the accelerometer contradicted the speed.
    pub(crate) differs: bool,
}

impl StartWatch {
    /// A step of the drive. `variance` is the power of the accelerometer's noise, m²/s⁴/Hz.
    pub(crate) fn step(&mut self, step: &Step, variance: f64) {
        if self.is_judged {
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
        self.is_judged = fast || self.time > WITHIN;
        if fast {
            let (margin, share) = TOLERANCE;
            // A NaN differs.
            let noise = DEVIATIONS * sqrt(variance * self.time);
            let fits = hypot(forward - speed, left) <= margin + share * fabs(speed) + noise;
            self.differs = !fits;
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Time, Velocity};

    use super::*;

    fn sample(yaw_rate: f64, forward_acceleration: f64) -> InertialSample {
        InertialSample {
            time: Time(0),
            yaw_rate,
            forward_acceleration,
            left_acceleration: 0.0,
        }
    }

    fn after(samples: impl IntoIterator<Item = InertialSample>) -> ImuWatch {
        let mut watch = ImuWatch::default();
        for sample in samples {
            watch.handle(&sample, &WatchConfig::paper(), (0.1, 1.0));
        }
        watch
    }

    fn verdict(samples: impl IntoIterator<Item = InertialSample>) -> ImuVerdict {
        after(samples).verdict(0.0, &WatchConfig::paper())
    }

    #[test]
    fn four_impossible_samples_are_tolerated_and_five_in_a_row_are_not() {
        for impossible in [
            sample(10.1, 0.0),
            sample(-10.1, 0.1),
            sample(0.0, 35.1),
            sample(f64::NAN, 0.0),
            sample(0.0, f64::INFINITY),
        ] {
            let good = sample(9.9, 34.9);
            assert_eq!(verdict([impossible; 4]), ImuVerdict::Good);
            assert_eq!(verdict([impossible; 5]), ImuVerdict::Implausible);
            let mixed = (0..40).map(|i| if i % 5 == 4 { good } else { impossible });
            assert_eq!(verdict(mixed), ImuVerdict::Good);
        }
    }

    #[test]
    fn a_gyro_bias_beyond_the_limit_is_implausible() {
        let watch = after([]);
        for (bias, expected) in [
            (0.2, ImuVerdict::Good),
            (-0.2, ImuVerdict::Good),
            (0.201, ImuVerdict::Implausible),
            (-0.201, ImuVerdict::Implausible),
        ] {
            assert_eq!(watch.verdict(bias, &WatchConfig::paper()), expected);
        }
    }

    #[test]
    fn samples_that_repeat_to_the_last_bit_are_stuck() {
        // The first sample is not a repetition.
        assert_eq!(verdict([sample(0.1, 0.2); 25]), ImuVerdict::Good);
        assert_eq!(verdict([sample(0.1, 0.2); 26]), ImuVerdict::Stuck);
        let off = WatchConfig {
            stuck_samples: 0,
            ..WatchConfig::paper()
        };
        assert_eq!(
            after([sample(0.1, 0.2); 99]).verdict(0.0, &off),
            ImuVerdict::Good
        );
        for differing in [
            |i: u32| sample(f64::from(i % 2) * 1e-3, 0.2),
            |i: u32| sample(0.1, f64::from(i % 2) * 1e-3),
            |i: u32| InertialSample {
                left_acceleration: f64::from(i % 2) * 1e-3,
                ..sample(0.1, 0.2)
            },
        ] {
            assert_eq!(verdict((0..100).map(differing)), ImuVerdict::Good);
        }
    }

    #[test]
    fn it_is_still_after_twenty_samples_without_movement() {
        let still = |count| after(std::vec![sample(0.05, -0.5); count]).is_still();
        assert!(!still(19) && still(20));
        let then = |last| {
            let mut samples = std::vec![sample(0.0, 0.0); 100];
            samples.push(last);
            after(samples).is_still()
        };
        assert!(!then(sample(0.1, 0.0)) && !then(sample(0.0, 1.0)));
        // No car can move like this: five of them in a row make the sensor implausible.
        assert!(then(sample(f64::NAN, 0.0)) && then(sample(32.768, 0.0)));
    }

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
                watch.is_opposite
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
                assert!(!watch.is_opposite);
            }
            // A bias of 1 rad/s, while the bend is entered.
            let found = [-0.001, -0.02, -0.025, -0.03].map(|turn| {
                watch.step(&step(0.05, turn, turn + 0.05));
                watch.is_opposite
            });
            assert!(found[3], "{before}: {found:?}");
        }
    }

    #[test]
    fn a_slow_turn_is_compared_over_eight_steps() {
        let mut watch = GyroWatch::default();
        let found = [-0.006; 8].map(|gyro_turn| {
            watch.step(&step(0.05, 0.006, gyro_turn));
            watch.is_opposite
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
        assert!(!watch.is_opposite);
    }

    #[test]
    fn the_next_drive_begins_anew() {
        let mut watch = GyroWatch::default();
        while !watch.is_opposite {
            watch.step(&step(0.1, 0.05, -0.05));
        }
        watch = GyroWatch::default();
        assert!(!watch.is_opposite);
    }

    /// A step with its time (s), its speed (m/s), and what the accelerometer measures forward
    /// and to the left (m/s).
    fn starting(time: f64, speed: f64, forward: f64, left: f64) -> Step {
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

    fn after_start(steps: &[Step]) -> StartWatch {
        let mut watch = StartWatch::default();
        for step in steps {
            watch.step(step, 0.0);
        }
        watch
    }

    #[test]
    fn a_start_is_judged_at_its_speed() {
        assert!(!after_start(&[]).is_judged);
        assert!(!after_start(&[starting(0.1, 0.179, 0.0, 0.0)]).is_judged);
        assert!(after_start(&[starting(0.1, 0.181, 0.0, 0.0)]).is_judged);
    }

    #[test]
    fn a_slow_start_is_over_after_half_a_second_and_says_nothing() {
        let slow = starting(0.25, 0.1, 5.0, 5.0);
        assert!(!after_start(&[slow]).is_judged);
        assert!(!after_start(&[slow, slow]).is_judged);
        let watch = after_start(&[slow, slow, slow]);
        assert!(watch.is_judged && !watch.differs);
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
            let slow = starting(0.05, 0.1, 0.05, part);
            let watch = after_start(&[slow, slow, starting(0.1, 0.3, forward, left)]);
            assert!(watch.is_judged);
            assert_eq!(watch.differs, differs, "{forward} {left}");
        }
    }

    #[test]
    fn the_verdict_stays_until_the_next_drive() {
        let good = starting(0.1, 0.3, 0.6, 0.0);
        let bad = starting(0.1, 0.3, -0.6, 0.0);
        let mut watch = after_start(&[bad, good, good]);
        assert!(watch.differs);
        watch = StartWatch::default();
        assert!(!watch.is_judged && !watch.differs);
        watch.step(&good, 0.0);
        watch.step(&bad, 0.0);
        assert!(watch.is_judged && !watch.differs);
    }

    #[test]
    fn a_start_in_reverse_is_compared_with_its_sign() {
        let start = |forward: f64| {
            let speeds = [-0.05, -0.1, -0.15, -0.2];
            after_start(&speeds.map(|speed| starting(0.05, speed, forward, 0.0)))
        };
        assert!(start(-0.05).is_judged && !start(-0.05).differs);
        assert!(start(0.05).differs && start(0.0).differs);
    }
}
