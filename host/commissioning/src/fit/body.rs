//! Where the rigid body of the cameras sits on the car, from turning and rolling it by hand or from
//! a drive with bends.

use singletrack_control::wrap;

use super::{Motion, Signal};
use crate::{PoseReading, fit::least_squares};

impl PoseReading {
    /// The place on the floor, m, of the point from which the body's origin is at `origin`, along
    /// the body's axes.
    pub(crate) fn place_of(&self, origin: [f64; 2]) -> [f64; 2] {
        let ([x, y, _], (sin, cos)) = (self.position, self.yaw.sin_cos());
        [
            x - cos * origin[0] + sin * origin[1],
            y - sin * origin[0] - cos * origin[1],
        ]
    }
}

/// The body's origin, from the point about which the body was turned, along the axes of the
/// body, in m. The second value is the root mean square of the wander of that point. None if the
/// body did not turn.
pub(crate) fn turned_about(poses: &[PoseReading]) -> Option<([f64; 2], f64)> {
    let equations = poses.iter().flat_map(|pose| {
        let ([x, y, _], (sin, cos)) = (pose.position, pose.yaw.sin_cos());
        [([1.0, 0.0, cos, -sin], x), ([0.0, 1.0, sin, cos], y)]
    });
    let fit = least_squares(equations)?;
    let [_, _, forward, left] = fit.parameters;
    Some(([forward, left], fit.residual))
}

/// A roll of the car, straight or nearly so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rolled {
    /// The way of the point, in m.
    pub(crate) way: f64,
    /// The direction in which it moved, from the body's x axis, in rad: to the left is positive.
    pub(crate) direction: f64,
    /// The angle that the body turned by, in rad.
    pub(crate) turn: f64,
}

/// How a point of the car moved that is at `-origin` from the body's origin, along the axes of
/// the body. None if it did not move.
///
/// The middle of the rear axle moves along the car, also when the front wheels are not straight:
/// the direction of its movement gives the yaw of the body on the car.
pub(crate) fn rolled(poses: &[PoseReading], origin: [f64; 2]) -> Option<Rolled> {
    /// Shorter movements are noise, in m.
    const SPACING: f64 = 0.05;
    let first = poses.first()?;
    let mut last = first;
    let mut moved = [0.0; 2];
    let mut way = 0.0;
    for pose in poses {
        let (from, to) = (last.place_of(origin), pose.place_of(origin));
        let step = [to[0] - from[0], to[1] - from[1]];
        let length = step[0].hypot(step[1]);
        if length < SPACING {
            continue;
        }
        // A chord points along the mean of the yaws at its ends.
        let turn = wrap(pose.yaw - last.yaw);
        let (sin, cos) = (last.yaw + turn / 2.0).sin_cos();
        moved[0] += cos * step[0] + sin * step[1];
        moved[1] += cos * step[1] - sin * step[0];
        way += length;
        last = pose;
    }
    (way > 0.0).then(|| Rolled {
        way,
        direction: moved[1].atan2(moved[0]),
        turn: wrap(last.yaw - first.yaw),
    })
}

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
    let (mut sideways, mut forward) = (Vec::new(), Vec::new());
    let mut start = 0;
    for (index, end) in motion.0.iter().enumerate() {
        let begin = motion.0[start];
        let span = end.time - begin.time;
        if span < WINDOW {
            continue;
        }
        let turn = end.yaw - begin.yaw;
        let moved = &displacement[start..index];
        let along: f64 = moved.iter().map(|[along, _]| along).sum();
        let across: f64 = moved.iter().map(|[_, across]| across).sum();
        let speed = along / span;
        let slip = rear_slip * speed * speed * turn;
        sideways.push(([turn, -along], across + slip));
        forward.push(([way.at(end.time) - way.at(begin.time), -turn], along));
        start = index;
    }
    let [ahead, turned] = least_squares(sideways.iter().copied())?.parameters;
    let [_, left] = least_squares(forward.iter().copied())?.parameters;
    Some(Body {
        yaw: body_yaw + turned,
        ahead,
        left,
    })
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use singletrack_control::Time;
    use singletrack_control::statistics::Random;

    use super::*;
    use crate::fit::mean_interval;

    const ORIGIN: [f64; 2] = [0.21, -0.03];

    /// The body of a car whose rear axle is here; the body sits at `ORIGIN` along its own axes,
    /// and is turned by `body_yaw` on the car.
    fn body(noise: &mut Random, rear: [f64; 2], yaw: f64, body_yaw: f64) -> PoseReading {
        let turned = yaw + body_yaw;
        let (sin, cos) = turned.sin_cos();
        let x = rear[0] + cos * ORIGIN[0] - sin * ORIGIN[1] + 0.000_2 * noise.normal(1.0);
        let y = rear[1] + sin * ORIGIN[0] + cos * ORIGIN[1] + 0.000_2 * noise.normal(1.0);
        pose(x, y, turned + 0.001_7 * noise.normal(1.0))
    }

    const fn pose(x: f64, y: f64, yaw: f64) -> PoseReading {
        PoseReading {
            capture: Time(0),
            receive: Time(0),
            uncertainty: 0.0,
            position: [x, y, 0.0],
            yaw,
            roll: 0.0,
            pitch: 0.0,
            mean_error: 0.0,
        }
    }

    #[test]
    fn turns_about_a_point_that_wanders_give_honest_intervals() {
        let mut held = [0; 2];
        let cars = 300;
        for car in 0..cars {
            let mut noise = Random::new(car);
            let mut found = [const { Vec::new() }; 2];
            for pass in 0..4 {
                let sign = if pass % 2 == 0 { 1.0 } else { -1.0 };
                let wander = 0.003 * noise.normal(1.0);
                let phase = 2.0 * PI * noise.uniform();
                let poses: Vec<_> = (0..800)
                    .map(|index| {
                        let share = f64::from(index) / 800.0;
                        let rear = [1.0, 1.0 + 0.3 * f64::from(pass)]
                            .map(|at| at + wander * (2.0 * PI * share + phase + at).sin());
                        body(&mut noise, rear, sign * 2.0 * PI * share, 0.4)
                    })
                    .collect();
                let (origin, residual) = turned_about(&poses).unwrap();
                assert!(residual < 0.01);
                found[0].push(origin[0]);
                found[1].push(origin[1]);
            }
            for axis in 0..2 {
                let interval = mean_interval(&found[axis], 0.0).unwrap();
                held[axis] += u64::from(interval.contains(ORIGIN[axis]));
            }
        }
        for held in held {
            assert!(held * 100 >= cars * 90, "{held} of {cars}");
        }
    }

    #[test]
    fn a_curve_gives_the_yaw_of_the_body_and_the_way_of_the_rear_axle() {
        for (body_yaw, curvature) in [(0.0, 0.0), (0.1, 0.2), (-2.5, -0.3), (PI - 0.05, 0.1)] {
            let mut noise = Random::new(5);
            let poses: Vec<_> = (0..600)
                .map(|index| {
                    let way = 2.0 * f64::from(index) / 599.0;
                    let yaw = 0.7 + curvature * way;
                    let rear = if curvature == 0.0 {
                        [way * yaw.cos(), way * yaw.sin()]
                    } else {
                        let radius = 1.0 / curvature;
                        [
                            radius * (yaw.sin() - 0.7_f64.sin()),
                            radius * (0.7_f64.cos() - yaw.cos()),
                        ]
                    };
                    body(&mut noise, rear, yaw, body_yaw)
                })
                .collect();
            let rolled = rolled(&poses, ORIGIN).unwrap();
            let error = (rolled.direction + body_yaw).sin();
            assert!(error.abs() < 0.002, "{body_yaw} {curvature}: {rolled:?}");
            assert!((rolled.way - 2.0).abs() < 0.055, "{rolled:?}");
            assert!((rolled.turn - 2.0 * curvature).abs() < 0.03, "{rolled:?}");
        }
    }

    #[test]
    fn a_body_that_stands_has_neither_point_nor_direction() {
        let pose = pose(1.0, 2.0, 0.3);
        assert_eq!(turned_about(&[pose; 50]), None);
        assert_eq!(rolled(&[pose; 50], [0.0; 2]), None);
        assert_eq!(rolled(&[], [0.0; 2]), None);
    }
}
