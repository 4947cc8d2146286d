//! Where the rigid body is on the car, from a drive with bends.

use super::{Motion, Signal, least_squares};

/// The rigid body on the car, as one pass shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Body {
    /// Yaw of the body when that of the car is zero, rad.
    pub(crate) yaw: f64,
    /// Position of the pivot ahead of the rear axle, m.
    pub(crate) ahead: f64,
    /// Position of the pivot to the left of the middle, m.
    pub(crate) left: f64,
}

/// The duration of the windows, s.
const WINDOW: f64 = 1.0;

/// Fits the body. The rear axle rolls along the car, but for its slip: `rear_slip` rad per m/s²
/// of lateral acceleration. `body_yaw` is about the yaw of the body, `way` that of the motor
/// pulses. None without bends to both sides.
pub(crate) fn body(motion: &Motion, way: &Signal, body_yaw: f64, rear_slip: f64) -> Option<Body> {
    let displacement = motion.displacement(body_yaw);
    // Turn, way along and across, slip, way of the motor.
    let mut windows: Vec<[f64; 5]> = Vec::new();
    let mut start = 0;
    for end in 1..motion.time.len() {
        let span = motion.time[end] - motion.time[start];
        if span < WINDOW {
            continue;
        }
        let turn = motion.yaw[end] - motion.yaw[start];
        let moved = &displacement[start..end];
        let along: f64 = moved.iter().map(|[along, _]| along).sum();
        let across: f64 = moved.iter().map(|[_, across]| across).sum();
        let speed = along / span;
        let motor = way.at(motion.time[end]) - way.at(motion.time[start]);
        windows.push([turn, along, across, rear_slip * speed * speed * turn, motor]);
        start = end;
    }
    let sideways = least_squares(
        windows
            .iter()
            .map(|&[turn, along, across, slip, _]| ([turn, -along], across + slip)),
    )?;
    let [ahead, turned] = sideways.parameters;
    let forward = least_squares(
        windows
            .iter()
            .map(|&[turn, along, _, _, motor]| ([motor, -turn], along)),
    )?;
    let [_, left] = forward.parameters;
    Some(Body {
        yaw: body_yaw + turned,
        ahead,
        left,
    })
}
