//! Whether the car stays on its stand, by the cameras.

use singletrack_control::Time;

use crate::PoseReading;

/// Way by which a car on its stand may shake, m, in several poses and in one.
const SHAKES_M: f64 = 0.02;
const JUMPS_M: f64 = 0.06;

/// Turn by which it may shake, rad.
const SHAKES_RAD: f64 = 0.1;

/// Poses in a row beyond these limits after which the car counts as moving.
const MOVING_POSES: u32 = 3;

/// Poses whose mean is the place of the car.
const PLACE_POSES: u32 = 10;

/// The place of a car, which it must not leave.
#[derive(Debug, Default)]
pub(super) struct Place {
    poses: u32,
    sum: [f64; 3],
    yaw: f64,
    off: u32,
    /// How far the car has moved when it has left its place, m.
    pub(super) left: Option<f64>,
    /// When the last pose arrived.
    pub(super) seen: Option<Time>,
}

impl Place {
    pub(super) fn see(&mut self, pose: &PoseReading) {
        self.seen = Some(pose.receive);
        if self.poses < PLACE_POSES {
            if self.poses == 0 {
                self.yaw = pose.yaw;
            }
            self.poses += 1;
            for (sum, value) in self.sum.iter_mut().zip(pose.position) {
                *sum += value;
            }
            return;
        }
        let poses = f64::from(self.poses);
        let squares: f64 = self
            .sum
            .iter()
            .zip(pose.position)
            .map(|(sum, value)| (value - sum / poses).powi(2))
            .sum();
        let way = squares.sqrt();
        let turn = (pose.yaw - self.yaw).sin().abs();
        self.off = if way > SHAKES_M || turn > SHAKES_RAD {
            self.off + 1
        } else {
            0
        };
        if self.off >= MOVING_POSES || way > JUMPS_M {
            self.left = Some(way);
        }
    }

    pub(super) fn is_known(&self) -> bool {
        self.poses >= PLACE_POSES
    }
}
