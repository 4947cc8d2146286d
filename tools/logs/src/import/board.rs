//! The samples of the board, from the sensors of a log.

use singletrack_control::{InertialSample, Time};
use singletrack_pilot::{BoardSample, BoardState};

use super::{log::Log, samples::Sample};

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
        let rows: Vec<_> = match &log.inertial {
            Some(inertial) => {
                let samples = inertial.resampled().into_iter();
                let row =
                    |it: Sample<3>| (it.time_ns, Some(it.values), log.motor_speed.at(it.time_ns));
                samples.map(row).collect()
            }
            None => {
                let samples = log.motor_speed.resampled().into_iter();
                samples
                    .map(|it| (it.time_ns, None, Some(it.values)))
                    .collect()
            }
        };
        let sample = |(time_ns, inertial, motor): &(u64, Option<[f64; 3]>, Option<[f64; 1]>)| {
            let time = Time(*time_ns);
            let [motor_speed] = (*motor)?;
            let inertial = inertial.map(|[forward, left, yaw_rate]| InertialSample {
                time,
                yaw_rate,
                forward_acceleration: forward,
                left_acceleration: left,
            });
            let state = match log.is_driving(*time_ns) {
                true => BoardState::Driving,
                false => BoardState::Neutral,
            };
            Some(BoardSample {
                time,
                inertial,
                motor_speed,
                state,
            })
        };
        let samples: Vec<_> = rows.iter().filter_map(sample).collect();
        Self {
            without_motor_speed: (rows.len() - samples.len()) as u64,
            samples,
        }
    }
}
