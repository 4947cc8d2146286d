//! The motion of the car between poses, by every sensor.

use heapless::Deque;
use singletrack_control::{InertialSample, Position, Time, Velocity, direction};

/// The shortest time between the poses of a step, s.
const SHORTEST: f64 = 0.04;
/// The longest one: beyond it the path between them is unknown, s.
const LONGEST: f64 = 0.12;
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
    /// The same to the left, without the centripetal part.
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
        Some(step)
    }

    fn restart(&mut self, start: Start) {
        self.start = Some(start);
        self.sums = Sums::default();
    }

    /// The speed that the cameras see, m/s; `None` without recent poses.
    pub(crate) fn camera_speed(&self, now: Time) -> Option<f64> {
        let (newest, end) = *self.poses.back()?;
        if now.seconds_since(newest) > RECENT {
            return None;
        }
        let (shortest, longest) = SPAN;
        let (start, from) = self
            .poses
            .iter()
            .find(|(time, _)| newest.seconds_since(*time) <= longest + APART)?;
        let span = newest.seconds_since(*start);
        (span >= shortest).then(|| (end - from).norm() / span)
    }

    /// Forgets the poses: the estimate restarts.
    pub(crate) fn reset(&mut self) {
        self.poses.clear();
        self.start = None;
        self.sums = Sums::default();
    }
}
