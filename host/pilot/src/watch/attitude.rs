//! Attitude, height and clock of the sensors, and the direction of a car that is pushed.

use libm::{atan2, fabs, hypot, sincos};
use singletrack_control::Time;

use super::{WatchConfig, count, steps::Step};
use crate::{
    event::{AttitudeSample, Tilt},
    supervisor::Reason,
};

/// The number of samples in a row with an uncertain mid-exposure: 0.5 s.
const UNCERTAIN: u32 = 5;

/// The age of a sample at which it counts no longer, s.
const AGE: f64 = 0.5;

/// The latest attitude of IMU and body.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AttitudeWatch {
    imu: Option<(Tilt, HandledAt)>,
    body: Option<(Tilt, HandledAt)>,
    height: Option<(f64, HandledAt)>,
    uncertain: u32,
}

/// The tick that handled a sample; `None` in that tick.
type HandledAt = Option<Time>;

impl AttitudeWatch {
    /// A sample.
    pub(crate) fn handle(&mut self, sample: &AttitudeSample, config: &WatchConfig) {
        self.imu = sample.imu.map(|imu| (imu, None)).or(self.imu);
        self.body = sample.body.map(|body| (body, None)).or(self.body);
        self.height = sample.height.map(|height| (height, None)).or(self.height);
        if let Some(uncertainty) = sample.capture_uncertainty {
            // A NaN is uncertain.
            let is_certain = uncertainty <= config.max_capture_uncertainty;
            count(&mut self.uncertain, !is_certain);
        }
    }

    /// A tick: dates the samples since the last one.
    pub(crate) fn tick(&mut self, now: Time) {
        date(&mut self.imu, now);
        date(&mut self.body, now);
        date(&mut self.height, now);
    }

    /// What forbids to arm; the body's axes are turned by `marker_yaw` (rad) against the
    /// car's.
    pub(crate) fn check(&self, marker_yaw: f64, config: &WatchConfig) -> Option<Reason> {
        // A NaN is within no limit.
        let level = |tilt: Tilt| hypot(tilt.roll, tilt.pitch) <= config.max_tilt;
        if self.imu.is_some_and(|(tilt, _)| !level(tilt)) {
            return Some(Reason::ImuTilted);
        }
        if let (Some((imu, _)), Some((body, _))) = (self.imu, self.body) {
            let (s, c) = sincos(marker_yaw);
            // Tilts are small: they turn as vectors do.
            let roll = c * body.roll + s * body.pitch;
            let pitch = c * body.pitch - s * body.roll;
            let most = fabs(imu.roll - roll).max(fabs(imu.pitch - pitch));
            let agree = most <= config.max_tilt_difference;
            if !agree {
                return Some(Reason::TiltDiffers);
            }
        }
        let [low, high] = config.height;
        let within = |height: f64| low <= height && height <= high;
        let wrong = self.height.is_some_and(|(height, _)| !within(height));
        wrong.then_some(Reason::PoseHeight)
    }

    /// Whether the mid-exposure of the poses has been uncertain for too long.
    pub(crate) const fn is_uncertain(&self) -> bool {
        self.uncertain >= UNCERTAIN
    }
}

fn date<T>(value: &mut Option<(T, HandledAt)>, now: Time) {
    match value {
        Some((_, heard @ None)) => *heard = Some(now),
        Some((_, Some(heard))) if now.seconds_since(*heard) > AGE => *value = None,
        _ => {}
    }
}

/// The line along which a car that is not driven was rolled by hand.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PushWatch {
    along: f64,
    across: f64,
    motor_way: f64,
    /// Whether the yaw of the body does not fit the last motion.
    pub(crate) is_wrong: bool,
}

/// The way that the car must roll, m.
const ROLLED: f64 = 0.2;
/// A step must be at least this long, m: a standing car has noise.
const STEP: f64 = 0.004;
/// Above this angle the yaw is wrong, and below the second it is right again, rad.
const WRONG: (f64, f64) = (0.17, 0.1);
/// The largest turn of a step, rad: the car is rolled straight.
const STRAIGHT: f64 = 0.05;
/// The share by which the way of the wheels may differ: they roll, and the car is not
/// carried.
const ROLLS: f64 = 0.25;

impl PushWatch {
    /// A step of a car that is not driven.
    pub(crate) fn step(&mut self, step: &Step) {
        let way = step.rear.norm();
        let rolls = fabs(step.motor_way - way) <= ROLLS * way;
        if way < STEP || fabs(step.turn) > STRAIGHT || !rolls {
            *self = Self {
                is_wrong: self.is_wrong,
                ..Self::default()
            };
            return;
        }
        self.along += step.along();
        self.across += step.across();
        self.motor_way += step.motor_way;
        if self.motor_way >= ROLLED {
            // The pulses have no sign: a car rolls backward as well. A body that is turned by
            // a right angle or more shows in the first metre.
            let angle = fabs(atan2(self.across, fabs(self.along)));
            let (wrong, right) = WRONG;
            self.is_wrong = angle > wrong || (self.is_wrong && angle > right);
            *self = Self {
                is_wrong: self.is_wrong,
                ..Self::default()
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use libm::tan;
    use singletrack_control::{Velocity, direction};

    use super::*;

    fn at(ms: u64) -> Time {
        Time(1_000_000_000 + ms * 1_000_000)
    }

    fn tilt(roll: f64, pitch: f64) -> Option<Tilt> {
        Some(Tilt { roll, pitch })
    }

    fn heard(sample: AttitudeSample, config: &WatchConfig) -> AttitudeWatch {
        let mut watch = AttitudeWatch::default();
        watch.handle(&sample, config);
        watch
    }

    fn checked(sample: AttitudeSample, marker_yaw: f64, config: &WatchConfig) -> Option<Reason> {
        heard(sample, config).check(marker_yaw, config)
    }

    #[test]
    fn a_tilted_imu_forbids_to_arm() {
        for ((roll, pitch), expected) in [
            ((0.0, 0.0), None),
            ((0.149, 0.0), None),
            ((0.0, -0.149), None),
            ((0.11, 0.11), Some(Reason::ImuTilted)),
            ((-0.151, 0.0), Some(Reason::ImuTilted)),
            ((0.0, 0.151), Some(Reason::ImuTilted)),
            ((f64::NAN, 0.0), Some(Reason::ImuTilted)),
        ] {
            let sample = AttitudeSample {
                imu: tilt(roll, pitch),
                ..AttitudeSample::default()
            };
            let reason = checked(sample, 0.0, &WatchConfig::paper());
            assert_eq!(reason, expected, "{roll} {pitch}");
        }
    }

    #[test]
    fn a_body_that_tilts_otherwise_than_the_imu_forbids_to_arm() {
        for ((roll, pitch), expected) in [
            ((0.199, -0.1), None),
            ((0.05, -0.249), None),
            ((0.201, -0.1), Some(Reason::TiltDiffers)),
            ((-0.101, -0.1), Some(Reason::TiltDiffers)),
            ((0.05, 0.051), Some(Reason::TiltDiffers)),
            ((0.05, -0.251), Some(Reason::TiltDiffers)),
            ((0.05, f64::NAN), Some(Reason::TiltDiffers)),
            ((f64::NAN, -0.1), Some(Reason::TiltDiffers)),
        ] {
            let sample = AttitudeSample {
                imu: tilt(0.05, -0.1),
                body: tilt(roll, pitch),
                ..AttitudeSample::default()
            };
            let reason = checked(sample, 0.0, &WatchConfig::paper());
            assert_eq!(reason, expected, "{roll} {pitch}");
        }
    }

    #[test]
    fn the_tilt_of_the_body_is_turned_by_the_yaw_of_its_axes() {
        let config = WatchConfig {
            max_tilt_difference: 1e-9,
            ..WatchConfig::paper()
        };
        // The cosine is 0.8 and the sine is 0.6.
        let yaw = atan2(3.0, 4.0);
        let sample = AttitudeSample {
            imu: tilt(0.11, -0.02),
            body: tilt(0.1, 0.05),
            ..AttitudeSample::default()
        };
        assert_eq!(checked(sample, yaw, &config), None);
        let expected = Some(Reason::TiltDiffers);
        assert_eq!(checked(sample, -yaw, &config), expected);
        assert_eq!(checked(sample, f64::NAN, &config), expected);
    }

    #[test]
    fn a_body_out_of_the_height_band_forbids_to_arm() {
        let config = WatchConfig {
            height: [0.05, 0.15],
            ..WatchConfig::paper()
        };
        for (height, expected) in [
            (0.05, None),
            (0.15, None),
            (0.049, Some(Reason::PoseHeight)),
            (0.151, Some(Reason::PoseHeight)),
            (f64::NAN, Some(Reason::PoseHeight)),
        ] {
            let sample = AttitudeSample {
                height: Some(height),
                ..AttitudeSample::default()
            };
            assert_eq!(checked(sample, 0.0, &config), expected, "{height}");
        }
    }

    #[test]
    fn a_sample_counts_for_half_a_second_after_its_first_tick() {
        let config = WatchConfig {
            height: [0.05, 0.15],
            ..WatchConfig::paper()
        };
        let none = AttitudeSample::default();
        let imu = AttitudeSample {
            imu: tilt(0.2, 0.0),
            ..none
        };
        let body = AttitudeSample {
            imu: tilt(0.0, 0.0),
            body: tilt(0.2, 0.0),
            ..none
        };
        let height = AttitudeSample {
            height: Some(0.2),
            ..none
        };
        for (sample, reason) in [
            (imu, Reason::ImuTilted),
            (body, Reason::TiltDiffers),
            (height, Reason::PoseHeight),
        ] {
            let mut watch = heard(sample, &config);
            for (ms, expected) in [(0, Some(reason)), (500, Some(reason)), (501, None)] {
                watch.tick(at(ms));
                assert_eq!(watch.check(0.0, &config), expected, "{ms} ms");
            }
            watch.handle(&sample, &config);
            watch.tick(at(9_000));
            watch.handle(&sample, &config);
            watch.tick(at(9_400));
            watch.handle(&none, &config);
            watch.tick(at(9_900));
            assert_eq!(watch.check(0.0, &config), Some(reason));
        }
    }

    #[test]
    fn five_uncertain_exposures_in_a_row_are_too_many() {
        let config = WatchConfig::paper();
        let mut watch = AttitudeWatch::default();
        let mut handle = |uncertainty: Option<f64>| {
            let sample = AttitudeSample {
                capture_uncertainty: uncertainty,
                ..AttitudeSample::default()
            };
            watch.handle(&sample, &config);
            watch.is_uncertain()
        };
        for uncertainty in [0.021, f64::NAN] {
            assert!(!handle(Some(0.02)), "the limit is allowed, and restarts");
            for _ in 0..4 {
                assert!(!handle(Some(uncertainty)));
            }
            assert!(!handle(None));
            assert!(handle(Some(uncertainty)));
            assert!(handle(Some(uncertainty)));
        }
    }

    /// A straight step by `way` at `angle` to the yaw.
    fn rolled(way: f64, angle: f64) -> Step {
        Step {
            time: 0.05,
            rear: way * direction(0.7 + angle),
            yaw: 0.7,
            turn: 0.0,
            gyro_turn: 0.0,
            forward: 0.0,
            left: 0.0,
            steering: 0.0,
            motor_way: way,
        }
    }

    fn pushed(watch: &mut PushWatch, steps: impl IntoIterator<Item = Step>) -> bool {
        for step in steps {
            watch.step(&step);
        }
        watch.is_wrong
    }

    #[test]
    fn a_car_that_rolls_aslant_has_a_wrong_yaw_until_it_rolls_straight_again() {
        for sign in [1.0, -1.0] {
            let mut watch = PushWatch::default();
            for (angle, wrong) in [
                (0.0, false),
                (0.169, false),
                (0.171, true),
                (0.101, true),
                (0.099, false),
                (0.101, false),
                (1.57, true),
            ] {
                let steps = [rolled(0.06, sign * angle); 4];
                assert_eq!(pushed(&mut watch, steps), wrong, "{angle}");
            }
        }
    }

    #[test]
    fn the_limits_of_the_angle_are_allowed() {
        let exact = |angle: f64| Step {
            rear: Velocity::new(1.0, tan(angle)),
            yaw: 0.0,
            ..rolled(1.0, 0.0)
        };
        let (wrong, right) = WRONG;
        for angle in [wrong, right] {
            assert_eq!(atan2(tan(angle), 1.0), angle, "the test is exact");
        }
        let mut watch = PushWatch::default();
        assert!(!pushed(&mut watch, [exact(wrong)]));
        assert!(pushed(&mut watch, [rolled(1.0, 0.2)]));
        assert!(!pushed(&mut watch, [exact(right)]));
    }

    #[test]
    fn a_car_that_rolls_backward_has_the_right_yaw() {
        let back = |way: f64, angle| Step {
            motor_way: way,
            ..rolled(-way, angle)
        };
        let mut watch = PushWatch::default();
        assert!(!pushed(&mut watch, [back(0.06, 0.1); 4]));
        assert!(pushed(&mut watch, [back(0.06, 0.2); 4]));
    }

    #[test]
    fn the_angle_is_that_of_the_whole_way() {
        let mut watch = PushWatch::default();
        assert!(!pushed(&mut watch, [rolled(0.19, 0.5)]), "too short a way");
        // The ways of 0.19 m and 0.5 m make an angle of 0.14 rad.
        assert!(!pushed(&mut watch, [rolled(0.5, 0.0)]));
        assert!(!pushed(&mut watch, [rolled(0.19, 0.5), rolled(0.19, -0.5)]));
    }

    #[test]
    fn only_steps_of_a_car_that_rolls_straight_count() {
        let step = rolled(0.05, 0.3);
        let turned = |turn| Step { turn, ..step };
        let wheels = |share| Step {
            motor_way: share * 0.05,
            ..step
        };
        for (step, counts) in [
            (rolled(0.004, 0.3), true),
            (rolled(0.0039, 0.3), false),
            (turned(0.05), true),
            (turned(0.051), false),
            (turned(-0.051), false),
            (wheels(0.76), true),
            (wheels(0.74), false),
            (wheels(1.24), true),
            (wheels(1.26), false),
            (wheels(f64::NAN), false),
        ] {
            let mut watch = PushWatch::default();
            // Along the world's axis, so that the length of a step is exact.
            let step = Step {
                rear: Velocity::new(step.rear.norm(), 0.0),
                yaw: 0.3,
                ..step
            };
            assert_eq!(pushed(&mut watch, [step; 60]), counts, "{step:?}");
        }
    }

    #[test]
    fn a_step_that_does_not_count_restarts_the_way_and_keeps_the_verdict() {
        let carried = Step {
            motor_way: 0.0,
            ..rolled(0.05, 0.0)
        };
        let mut watch = PushWatch::default();
        let short = rolled(0.19, 0.3);
        assert!(!pushed(&mut watch, [short, carried, short, carried]));
        assert!(pushed(&mut watch, [short, short]));
        assert!(pushed(&mut watch, [carried, rolled(0.19, 0.0)]));
        assert!(!pushed(&mut watch, [rolled(0.19, 0.0)]));
    }
}
