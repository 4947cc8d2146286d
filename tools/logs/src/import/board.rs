//! The samples of the board, from the sensors of a log.

use singletrack_control::{InertialSample, Time};
use singletrack_pilot::{BoardSample, BoardState};

use super::log::Log;

/// The samples of the board, in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BoardSamples {
    /// Each with a speed of the motor.
    pub(super) samples: Vec<BoardSample>,
    /// Inertial samples at times at which the speed of the motor is not known.
    pub(super) without_motor_speed: u64,
}

impl BoardSamples {
    /// A sample for each one of the IMU; of a log without an IMU, for each one of the motor.
    pub(super) fn new(log: &Log) -> Self {
        let state = |time_ns| match log.is_driving(time_ns) {
            true => BoardState::Driving,
            false => BoardState::Neutral,
        };
        let Some(inertial) = &log.inertial else {
            let samples = log.motor_speed.resampled();
            let samples = samples.iter().map(|sample| {
                let [motor_speed] = sample.values;
                BoardSample {
                    time: Time(sample.time_ns),
                    inertial: None,
                    motor_speed,
                    state: state(sample.time_ns),
                }
            });
            return Self {
                samples: samples.collect(),
                without_motor_speed: 0,
            };
        };
        let mut without_motor_speed = 0;
        let mut samples = Vec::new();
        for sample in inertial.resampled() {
            let Some([motor_speed]) = log.motor_speed.at(sample.time_ns) else {
                without_motor_speed += 1;
                continue;
            };
            let [forward_acceleration, left_acceleration, yaw_rate] = sample.values;
            let time = Time(sample.time_ns);
            samples.push(BoardSample {
                time,
                inertial: Some(InertialSample {
                    time,
                    yaw_rate,
                    forward_acceleration,
                    left_acceleration,
                }),
                motor_speed,
                state: state(sample.time_ns),
            });
        }
        Self {
            samples,
            without_motor_speed,
        }
    }
}
