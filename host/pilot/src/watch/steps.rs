//! The motion of the car between poses, by every sensor.

use heapless::Deque;
use singletrack_control::{InertialSample, Position, Time, Velocity, direction};

/// The shortest time between the poses of a step, s.
const SHORTEST: f64 = 0.04;
/// The longest one: beyond it the path between them is unknown, s.
const LONGEST: f64 = 0.12;
/// The longest time without a step, s: longer than markers may be lost.
const UNCOMPARED: f64 = 1.2;
/// The longest gap between inertial samples, s.
const GAP: f64 = 0.05;
/// The lag of the wheels behind the commanded steering, s: line, servo period and servo.
const STEERING_LAG: f64 = 0.06;
/// The number of poses for the speed of the cameras.
const POSES: usize = 16;
/// The shortest time between them, s: cameras may run at 240 Hz.
const APART: f64 = 0.008;
/// The shortest and the longest span of the cameras' speed, s.
const SPAN: (f64, f64) = (0.05, 0.1);
/// The longest age of the newest pose of that speed, s.
const RECENT: f64 = 0.1;
/// Poses that are farther apart are all that rare cameras have: up to this span, s, and for this
/// multiple of the time between the last two.
const RARE: (f64, f64) = (0.25, 1.2);

/// The motion between two poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    /// Duration, s.
    pub(crate) time: f64,
    /// Displacement of the middle of the rear axle, m, world frame.
    pub(crate) rear: Velocity,
    /// Mean yaw, rad.
    pub(crate) yaw: f64,
    /// Change of the yaw by the cameras and by the gyro, rad.
    pub(crate) turn: f64,
    pub(crate) gyro_turn: f64,
    /// Change of the forward speed by the accelerometer, m/s.
    pub(crate) forward: f64,
    /// Change of the speed to the left by the accelerometer, without the centripetal part, m/s.
    pub(crate) left: f64,
    /// Mean steering angle of the wheels, rad.
    pub(crate) steering: f64,
    /// Way by the motor pulses, m.
    pub(crate) motor_way: f64,
}

impl Step {
    /// Displacement of the rear axle along the yaw, m.
    pub(crate) fn along(&self) -> f64 {
        self.rear.dot(&direction(self.yaw))
    }

    /// Displacement of the rear axle to the left of the yaw, m. It is zero for a car that
    /// rolls, whatever its steering.
    pub(crate) fn across(&self) -> f64 {
        direction(self.yaw).perp(&self.rear)
    }
}

/// Collects steps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Steps {
    poses: Deque<(Time, Position), POSES>,
    start: Option<Start>,
    sums: Sums,
    imu: Option<InertialSample>,
    board: Option<Time>,
    steering: f64,
    tick: Option<Time>,
    /// The accelerometer and the gyro of a car that stands: forward, left, yaw rate.
    rest: [f64; 3],
    speed: f64,
    /// The end of the last step.
    compared: Option<Time>,
}

#[derive(Clone, Copy, Debug)]
struct Start {
    time: Time,
    rear: Position,
    yaw: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    gyro: f64,
    forward: f64,
    left: f64,
    motor: f64,
    steering: f64,
    steering_time: f64,
}

/// The share of a new sample in the mean of a standing car's: 0.3 s at 100 Hz.
const REST_SHARE: f64 = 0.03;

impl Steps {
    /// An inertial sample; `rests` if the car is known to stand.
    pub(crate) fn inertial(&mut self, sample: &InertialSample, rests: bool) {
        let values = [
            sample.forward_acceleration,
            sample.left_acceleration,
            sample.yaw_rate,
        ];
        if rests {
            for (rest, value) in self.rest.iter_mut().zip(values) {
                *rest += REST_SHARE * (value - *rest);
            }
        }
        if let Some(last) = self.imu {
            let time = sample.time.seconds_since(last.time);
            if time > 0.0 && time <= GAP {
                let yaw_rate = last.yaw_rate - self.rest[2];
                self.sums.gyro += time * yaw_rate;
                self.sums.forward += time * (last.forward_acceleration - self.rest[0]);
                let centripetal = self.speed * yaw_rate;
                self.sums.left += time * (last.left_acceleration - self.rest[1] - centripetal);
            }
        }
        self.imu = Some(*sample);
    }

    /// The speed of the motor, m/s, at a time of the board.
    pub(crate) fn motor(&mut self, time: Time, speed: f64) {
        if let Some(last) = self.board {
            let elapsed = time.seconds_since(last);
            if elapsed > 0.0 && elapsed <= GAP {
                self.sums.motor += elapsed * speed;
            }
        }
        self.board = Some(time);
    }

    /// A tick with the commanded steering, rad.
    pub(crate) fn tick(&mut self, now: Time, commanded: f64) {
        if let Some(last) = self.tick {
            let elapsed = now.seconds_since(last).clamp(0.0, GAP);
            self.steering += (commanded - self.steering) * (elapsed / STEERING_LAG).min(1.0);
            self.sums.steering += elapsed * self.steering;
            self.sums.steering_time += elapsed;
        }
        self.tick = Some(now);
    }

    /// An accepted pose of the centre of mass, whose yaw is not wrapped, and the distance of
    /// the rear axle, m. Returns a step if one is complete.
    pub(crate) fn pose(
        &mut self,
        time: Time,
        position: Position,
        yaw: f64,
        rear_axle: f64,
    ) -> Option<Step> {
        let apart = self
            .poses
            .back()
            .is_none_or(|(last, _)| time.seconds_since(*last) >= APART);
        if apart {
            if self.poses.is_full() {
                self.poses.pop_front();
            }
            let _ = self.poses.push_back((time, position));
        }
        let end = Start {
            time,
            rear: position - rear_axle * direction(yaw),
            yaw,
        };
        let Some(start) = self.start else {
            self.restart(end);
            return None;
        };
        let elapsed = time.seconds_since(start.time);
        if elapsed < SHORTEST {
            return None;
        }
        let sums = self.sums;
        self.restart(end);
        if elapsed > LONGEST {
            return None;
        }
        let turn = singletrack_control::wrap(yaw - start.yaw);
        let step = Step {
            time: elapsed,
            rear: end.rear - start.rear,
            yaw: start.yaw + 0.5 * turn,
            turn,
            gyro_turn: sums.gyro,
            forward: sums.forward,
            left: sums.left,
            steering: if sums.steering_time > 0.0 {
                sums.steering / sums.steering_time
            } else {
                self.steering
            },
            motor_way: sums.motor,
        };
        self.speed = step.along() / elapsed;
        self.compared = Some(time);
        Some(step)
    }

    fn restart(&mut self, start: Start) {
        self.start = Some(start);
        self.sums = Sums::default();
    }

    /// The speed that the cameras see, m/s; `None` without recent poses.
    pub(crate) fn camera_speed(&self, now: Time) -> Option<f64> {
        let (newest, end) = *self.poses.back()?;
        let before = |(time, _): &(Time, Position)| newest.seconds_since(*time);
        let ((shortest, longest), (farthest, wait)) = (SPAN, RARE);
        let apart = self.poses.iter().rev().nth(1).map_or(0.0, before);
        if now.seconds_since(newest) > (wait * apart).min(farthest).max(RECENT) {
            return None;
        }
        let usual = self
            .poses
            .iter()
            .find(|pose| before(pose) <= longest + APART);
        let (start, from) = usual.filter(|pose| before(pose) >= shortest).or_else(|| {
            let mut newest_first = self.poses.iter().rev();
            newest_first.find(|pose| (shortest..=farthest).contains(&before(pose)))
        })?;
        Some((end - from).norm() / newest.seconds_since(*start))
    }

    /// Whether the poses are too far apart for a step: whatever compares the sensors is blind.
    pub(crate) fn are_too_rare(&self, now: Time) -> bool {
        self.compared
            .is_none_or(|last| now.seconds_since(last) > UNCOMPARED)
    }

    /// Comparisons are waited for from here on.
    pub(crate) const fn begin(&mut self, now: Time) {
        self.compared = Some(now);
    }

    /// Forgets the poses: the estimate restarts.
    pub(crate) fn reset(&mut self) {
        self.poses.clear();
        self.start = None;
        self.sums = Sums::default();
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    use super::*;

    const EXACT: f64 = 1e-9;

    fn at(ms: u64) -> Time {
        Time(1_000_000_000 + ms * 1_000_000)
    }

    fn pose(steps: &mut Steps, ms: u64, x: f64) -> Option<Step> {
        steps.pose(at(ms), Position::new(x, 0.0), 0.0, 0.2)
    }

    fn inertial(steps: &mut Steps, ms: u64, values: [f64; 3], rests: bool) {
        let [yaw_rate, forward_acceleration, left_acceleration] = values;
        let sample = InertialSample {
            time: at(ms),
            yaw_rate,
            forward_acceleration,
            left_acceleration,
        };
        steps.inertial(&sample, rests);
    }

    /// The step between two poses of a standing car, with what happens between them.
    fn step_with(between: impl FnOnce(&mut Steps)) -> Step {
        let mut steps = Steps::default();
        assert_eq!(pose(&mut steps, 0, 0.0), None);
        between(&mut steps);
        pose(&mut steps, 100, 0.0).unwrap()
    }

    fn assert_near<const N: usize>(actual: [f64; N], expected: [f64; N]) {
        let near = |(a, e): (&f64, &f64)| (a - e).abs() < EXACT;
        assert!(
            actual.iter().zip(&expected).all(near),
            "{actual:?} {expected:?}"
        );
    }

    fn sums(step: &Step) -> [f64; 3] {
        [step.gyro_turn, step.forward, step.left]
    }

    #[test]
    fn a_step_has_the_motion_of_the_rear_axle_and_the_mean_yaw() {
        let mut steps = Steps::default();
        let none = steps.pose(at(0), Position::new(1.0, 2.0), 0.0, 0.2);
        assert_eq!(none, None);
        let step = steps
            .pose(at(50), Position::new(1.1, 2.0), FRAC_PI_2, 0.2)
            .unwrap();
        assert_near(
            [step.time, step.yaw, step.turn],
            [0.05, FRAC_PI_4, FRAC_PI_2],
        );
        assert_near([step.rear.x, step.rear.y], [0.3, -0.2]);
        // Along and across a yaw of 45 degrees.
        let diagonal = 0.5_f64.sqrt();
        assert_near(
            [step.along(), step.across()],
            [0.1 * diagonal, -0.5 * diagonal],
        );
    }

    #[test]
    fn a_turn_across_half_a_turn_is_short() {
        let mut steps = Steps::default();
        let origin = Position::origin();
        assert_eq!(steps.pose(at(0), origin, 3.1, 0.2), None);
        let step = steps.pose(at(50), origin, -3.1, 0.2).unwrap();
        let turn = 2.0 * (core::f64::consts::PI - 3.1);
        assert_near([step.turn, step.yaw], [turn, 3.1 + 0.5 * turn]);
    }

    #[test]
    fn a_step_takes_from_40_to_120_ms() {
        let mut steps = Steps::default();
        for (ms, time) in [
            (0, None),
            (39, None),
            (40, Some(0.04)),
            (79, None),
            (81, Some(0.041)),
            (201, Some(0.12)),
            (322, None),
            // The pose after too long a time starts the next step.
            (372, Some(0.05)),
        ] {
            let step = pose(&mut steps, ms, 0.0);
            assert_eq!(step.map(|step| step.time), time, "{ms} ms");
        }
    }

    #[test]
    fn each_inertial_sample_counts_until_the_next_one() {
        let step = step_with(|steps| {
            inertial(steps, 0, [1.0, 2.0, 4.0], false);
            inertial(steps, 20, [2.0, 3.0, 5.0], false);
            inertial(steps, 70, [9.0, 9.0, 9.0], false);
        });
        assert_near(sums(&step), [0.12, 0.19, 0.33]);
    }

    #[test]
    fn inertial_samples_do_not_count_over_a_gap_nor_back_in_time() {
        let step = step_with(|steps| {
            inertial(steps, 0, [1.0; 3], false);
            inertial(steps, 51, [1.0; 3], false);
            inertial(steps, 41, [f64::INFINITY; 3], false);
            inertial(steps, 41, [1.0; 3], false);
        });
        assert_eq!(sums(&step), [0.0; 3]);
    }

    #[test]
    fn the_mean_of_a_standing_car_is_taken_from_the_samples() {
        let step = step_with(|steps| {
            inertial(steps, 0, [1.0, 2.0, 4.0], true);
            inertial(steps, 20, [1.0, 2.0, 4.0], true);
        });
        let rest = 0.02 * 0.97 * 0.97;
        assert_near(sums(&step), [rest, 2.0 * rest, 4.0 * rest]);
    }

    #[test]
    fn the_centripetal_part_of_the_speed_before_is_taken_from_the_acceleration_to_the_left() {
        let mut steps = Steps::default();
        pose(&mut steps, 0, 0.0);
        assert!(pose(&mut steps, 50, 0.15).is_some(), "3 m/s");
        inertial(&mut steps, 50, [0.5, 0.0, 4.0], false);
        inertial(&mut steps, 70, [0.0; 3], false);
        let step = pose(&mut steps, 100, 0.15).unwrap();
        assert_near(sums(&step), [0.01, 0.0, 0.02 * 2.5]);
        // It stood during the last step.
        inertial(&mut steps, 110, [0.5, 0.0, 4.0], false);
        inertial(&mut steps, 130, [0.0; 3], false);
        let step = pose(&mut steps, 150, 0.15).unwrap();
        assert_near(sums(&step), [0.01, 0.0, 0.08]);
    }

    #[test]
    fn the_way_of_the_motor_is_the_sum_of_its_speed_since_the_time_before() {
        let step = step_with(|steps| {
            for (ms, speed) in [
                (0, 9.0),
                (20, 2.0),
                (70, 3.0),
                // Not over a gap, nor without time, nor back in time.
                (121, 9.0),
                (121, f64::INFINITY),
                (101, 9.0),
            ] {
                steps.motor(at(ms), speed);
            }
        });
        assert_near([step.motor_way], [0.04 + 0.15]);
    }

    #[test]
    fn the_mean_steering_lags_behind_the_commanded_one() {
        let step = step_with(|steps| {
            for ms in [0, 30, 60] {
                steps.tick(at(ms), 0.4);
            }
        });
        // The lag is 60 ms: 0.2 rad after 30 ms, and 0.3 rad after 60 ms.
        assert_near([step.steering], [0.25]);
        let step = step_with(|steps| {
            for (ms, commanded) in [(0, 0.4), (15, 0.4), (60, 0.4)] {
                steps.tick(at(ms), commanded);
            }
        });
        // 0.1 rad for 15 ms, then 0.325 rad for 45 ms.
        assert_near([step.steering], [0.25 * 0.1 + 0.75 * 0.325]);
    }

    #[test]
    fn a_late_tick_counts_as_a_gap_and_a_step_without_ticks_has_the_last_steering() {
        let mut steps = Steps::default();
        steps.tick(at(0), 0.0);
        steps.tick(at(900), 0.6);
        pose(&mut steps, 1_000, 0.0);
        let step = pose(&mut steps, 1_050, 0.0).unwrap();
        assert_near([step.steering], [0.5]);
        steps.tick(at(800), 0.0);
        let step = pose(&mut steps, 1_100, 0.0).unwrap();
        assert_near([step.steering], [0.5]);
    }

    #[test]
    fn poses_are_too_rare_when_for_1200_ms_none_followed_another_within_120() {
        for (apart, rare) in [(40, false), (120, false), (121, true), (130, true)] {
            let mut steps = Steps::default();
            assert!(steps.are_too_rare(at(0)));
            for ms in (0..3_000).step_by(apart) {
                pose(&mut steps, ms as u64, 0.0);
            }
            assert_eq!(steps.are_too_rare(at(3_000)), rare, "{apart} ms");
        }
        let mut steps = Steps::default();
        pose(&mut steps, 0, 0.0);
        pose(&mut steps, 50, 0.0);
        assert!(!steps.are_too_rare(at(1_250)) && steps.are_too_rare(at(1_251)));
        // The estimate restarts; what was compared stays so.
        steps.reset();
        assert!(!steps.are_too_rare(at(1_250)));
    }

    fn camera_speed(poses: impl IntoIterator<Item = (u64, f64)>, now: u64) -> Option<f64> {
        let mut steps = Steps::default();
        for (ms, x) in poses {
            pose(&mut steps, ms, x);
        }
        steps.camera_speed(at(now))
    }

    #[test]
    fn the_speed_of_the_cameras_needs_poses_that_are_recent_and_50_ms_apart() {
        let poses = [(0, 0.0), (50, 0.1)];
        assert_near([camera_speed(poses, 50).unwrap()], [2.0]);
        assert_near([camera_speed(poses, 150).unwrap()], [2.0]);
        assert_eq!(camera_speed(poses, 151), None);
        assert_eq!(camera_speed([(0, 0.0), (49, 0.1)], 49), None);
        assert_eq!(camera_speed([(0, 0.0)], 0), None);
        assert_eq!(camera_speed([], 0), None);
    }

    #[test]
    fn the_speed_of_the_cameras_is_that_of_the_last_tenth_of_a_second() {
        // A pose may be older by the 8 ms that the poses are apart.
        let speed = camera_speed([(0, 0.0), (55, 0.0), (105, -0.21)], 105);
        assert_near([speed.unwrap()], [2.0]);
        let speed = camera_speed([(0, 0.0), (60, 0.0), (110, -0.21)], 110);
        assert_near([speed.unwrap()], [4.2]);
    }

    #[test]
    fn rare_cameras_have_the_speed_of_their_last_two_poses_until_the_next_one_is_due() {
        let rare = [(0, 0.0), (110, 0.0), (220, 0.11)];
        for now in [220, 330, 352] {
            assert_near([camera_speed(rare, now).unwrap()], [1.0]);
        }
        assert_eq!(camera_speed(rare, 353), None);
        // The first poses after a gap are compared with the last one before it.
        let gap = [(0, 0.0), (10, 0.01), (150, 0.15), (160, 0.16)];
        assert_near([camera_speed(gap, 160).unwrap()], [1.0]);
        assert_eq!(camera_speed([(0, 0.0), (251, 0.251)], 251), None);
    }

    #[test]
    fn fast_cameras_fill_the_span_of_the_speed() {
        let fast = |ms: u64| (ms, 1e-3 * ms as f64);
        assert_near([camera_speed((0..500).map(fast), 500).unwrap()], [1.0]);
    }

    #[test]
    fn a_reset_forgets_the_poses_and_the_sums() {
        let mut steps = Steps::default();
        pose(&mut steps, 0, 0.0);
        pose(&mut steps, 50, 0.1);
        steps.motor(at(50), 1.0);
        steps.motor(at(60), 1.0);
        steps.reset();
        assert_eq!(steps.camera_speed(at(60)), None);
        assert_eq!(pose(&mut steps, 100, 0.1), None);
        let step = pose(&mut steps, 150, 0.1).unwrap();
        assert_eq!(step.motor_way, 0.0);
    }
}
