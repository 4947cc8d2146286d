//! From a message of ROS to a set-point of the daemon, or the reason against it.
//!
//! The daemon checks every set-point again. What is refused here is what only ROS knows: stamps
//! on the wall clock, and frames.

use std::time::Duration;

use singletrack_api::{Code, Refused, Setpoint, TrajectoryPoint};

use crate::{
    clocks::Now,
    message::{AckermannDriveStamped, Header, Path, Time, TwistStamped},
};

/// The frame of positions and of velocities of P.
const WORLD: &str = "world";
/// The frame of the car.
const BASE: &str = "base_link";

/// A stamp may be ahead of this computer's clock by this: clocks of two computers differ. The
/// set-point then counts as decided now.
const AHEAD: Duration = Duration::from_millis(5);

/// The bounds of a trajectory's number of points.
const FEWEST: usize = 2;
const MOST: usize = 100;

/// The judge of set-points.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Judge {
    pub(crate) max_age: Duration,
}

impl Judge {
    /// The velocity of P.
    pub(crate) fn velocity(&self, message: &TwistStamped, now: Now) -> Result<Setpoint, Refused> {
        let time_ns = self.decided(&message.header, now)?;
        in_frame(&message.header, &[WORLD])?;
        let (linear, angular) = (message.linear, message.angular);
        let rest = [linear.z, angular.x, angular.y, angular.z];
        finite([linear.x, linear.y].into_iter().chain(rest))?;
        if rest.iter().any(|&part| part != 0.0) {
            return Err(not_offered());
        }
        Ok(Setpoint {
            velocity_m_s: Some([linear.x, linear.y]),
            time_ns: Some(time_ns),
            ..Setpoint::default()
        })
    }

    /// Steering and speed.
    pub(crate) fn drive(
        &self,
        message: &AckermannDriveStamped,
        now: Now,
    ) -> Result<Setpoint, Refused> {
        let time_ns = self.decided(&message.header, now)?;
        in_frame(&message.header, &[BASE, ""])?;
        let rest = [
            message.steering_angle_velocity,
            message.acceleration,
            message.jerk,
        ];
        let used = [message.steering_angle, message.speed];
        finite(used.into_iter().chain(rest).map(f64::from))?;
        if rest.iter().any(|&part| part != 0.0) {
            return Err(not_offered());
        }
        Ok(Setpoint {
            steering_rad: Some(message.steering_angle.into()),
            speed_m_s: Some(message.speed.into()),
            time_ns: Some(time_ns),
            ..Setpoint::default()
        })
    }

    /// Timed positions of P, with velocities from the positions.
    pub(crate) fn path(&self, message: &Path, now: Now) -> Result<Setpoint, Refused> {
        let decided = self.decided(&message.header, now)?;
        in_frame(&message.header, &[WORLD])?;
        let poses = &message.poses;
        if !(FEWEST..=MOST).contains(&poses.len()) {
            return Err(no_path());
        }
        let mut points = Vec::with_capacity(poses.len());
        for pose in poses {
            in_frame(&pose.header, &[WORLD, ""])?;
            finite([pose.position.x, pose.position.y])?;
            points.push(Timed {
                wall: pose.header.stamp.ns(),
                position: [pose.position.x, pose.position.y],
            });
        }
        if !points.is_sorted_by(|first, second| first.wall < second.wall) {
            return Err(no_path());
        }
        let trajectory = velocities(&points)
            .zip(&points)
            .map(|(velocity, point)| {
                finite(velocity)?;
                let time_ns = u64::try_from(now.monotonic_at(point.wall)).map_err(|_| no_path())?;
                Ok(TrajectoryPoint {
                    time_ns,
                    position_m: point.position,
                    velocity_m_s: velocity,
                })
            })
            .collect::<Result<Vec<_>, Refused>>()?;
        Ok(Setpoint {
            trajectory: Some(trajectory),
            time_ns: Some(decided),
            ..Setpoint::default()
        })
    }

    /// When it was decided, on `CLOCK_MONOTONIC`.
    fn decided(&self, header: &Header, now: Now) -> Result<u64, Refused> {
        if header.stamp == Time::default() {
            return Err(Refused::new(
                Code::Invalid,
                "header.stamp is zero: give the time at which it was decided",
            ));
        }
        let old = || Refused::new(Code::Old, "header.stamp is older than --max-age-ms");
        let age = now.wall - header.stamp.ns();
        if age > self.max_age.as_nanos() as i128 {
            return Err(old());
        }
        if -age > AHEAD.as_nanos() as i128 {
            return Err(Refused::new(
                Code::Future,
                "header.stamp is in the future: are the clocks synchronised?",
            ));
        }
        u64::try_from(now.monotonic - age.max(0)).map_err(|_| old())
    }
}

/// A position at a time of the wall clock.
struct Timed {
    wall: i128,
    position: [f64; 2],
}

/// The velocities at the points: between two, the slope of the parabola through it and its
/// neighbours; at the ends, that of the line.
fn velocities(points: &[Timed]) -> impl Iterator<Item = [f64; 2]> {
    let slope = |from: Option<&Timed>, to: Option<&Timed>| {
        let (from, to) = (from?, to?);
        let time = (to.wall - from.wall) as f64 * 1e-9;
        let ([x, y], [to_x, to_y]) = (from.position, to.position);
        Some(([(to_x - x) / time, (to_y - y) / time], time))
    };
    (0..points.len()).map(move |index| {
        let here = points.get(index);
        let before = slope(index.checked_sub(1).and_then(|one| points.get(one)), here);
        let after = slope(here, points.get(index + 1));
        match (before, after) {
            (Some((b, time_b)), Some((a, time_a))) => {
                let total = time_b + time_a;
                let mean = |b: f64, a: f64| (b * time_a + a * time_b) / total;
                [mean(b[0], a[0]), mean(b[1], a[1])]
            }
            (Some((one, _)), None) | (None, Some((one, _))) => one,
            (None, None) => [0.0; 2],
        }
    })
}

fn in_frame(header: &Header, frames: &[&str]) -> Result<(), Refused> {
    if frames.contains(&header.frame_id.as_str()) {
        return Ok(());
    }
    Err(Refused::new(
        Code::Invalid,
        "header.frame_id must be \"world\" for velocities and paths, \"base_link\" or empty for /drive",
    ))
}

fn finite(numbers: impl IntoIterator<Item = f64>) -> Result<(), Refused> {
    if numbers.into_iter().all(f64::is_finite) {
        return Ok(());
    }
    Err(Refused::new(Code::NotFinite, "a number is not finite"))
}

fn not_offered() -> Refused {
    Refused::new(
        Code::Invalid,
        "only linear.x and linear.y of a velocity, and steering_angle and speed of /drive, may \
         differ from zero",
    )
}

fn no_path() -> Refused {
    Refused::new(
        Code::OutOfRange,
        "a path has 2 to 100 poses with increasing stamps",
    )
}

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    reason = "a test may fail"
)]
mod tests {
    use super::*;
    use crate::message::{PoseStamped, Vector3};

    const JUDGE: Judge = Judge {
        max_age: Duration::from_millis(100),
    };
    const MS: i128 = 1_000_000;
    const NOW: Now = Now {
        monotonic: 7_000_000_000,
        wall: 1_700_000_000_000_000_000,
    };

    fn code(judged: Result<Setpoint, Refused>) -> Option<Code> {
        judged.err().map(|refused| refused.code)
    }

    fn header(age_ms: i128, frame: &str) -> Header {
        Header {
            stamp: Time::from_ns(NOW.wall - age_ms * MS),
            frame_id: frame.to_owned(),
        }
    }

    fn twist(age_ms: i128) -> TwistStamped {
        TwistStamped {
            header: header(age_ms, "world"),
            linear: Vector3 {
                x: 0.5,
                y: -0.25,
                z: 0.0,
            },
            angular: Vector3::default(),
        }
    }

    fn drive(age_ms: i128) -> AckermannDriveStamped {
        AckermannDriveStamped {
            header: header(age_ms, "base_link"),
            steering_angle: 0.25,
            speed: 1.5,
            ..AckermannDriveStamped::default()
        }
    }

    #[test]
    fn a_velocity_keeps_its_age_on_the_other_clock() {
        assert_eq!(
            JUDGE.velocity(&twist(30), NOW).unwrap(),
            Setpoint {
                velocity_m_s: Some([0.5, -0.25]),
                time_ns: Some(6_970_000_000),
                ..Setpoint::default()
            }
        );
    }

    #[test]
    fn a_drive_is_steering_and_speed() {
        assert_eq!(
            JUDGE.drive(&drive(0), NOW).unwrap(),
            Setpoint {
                steering_rad: Some(0.25),
                speed_m_s: Some(1.5),
                time_ns: Some(7_000_000_000),
                ..Setpoint::default()
            }
        );
    }

    #[test]
    fn stamps_decide_to_the_millisecond() {
        assert!(JUDGE.velocity(&twist(100), NOW).is_ok());
        assert_eq!(code(JUDGE.velocity(&twist(101), NOW)), Some(Code::Old));
        assert_eq!(code(JUDGE.drive(&drive(1_000), NOW)), Some(Code::Old));
        assert_eq!(code(JUDGE.velocity(&twist(-6), NOW)), Some(Code::Future));
        let ahead = JUDGE.velocity(&twist(-5), NOW).unwrap();
        assert_eq!(ahead.time_ns, Some(7_000_000_000), "never in the future");
        let mut none = twist(0);
        none.header.stamp = Time::default();
        assert_eq!(code(JUDGE.velocity(&none, NOW)), Some(Code::Invalid));
    }

    #[test]
    fn other_frames_are_refused() {
        for frame in ["", "map", "base_link"] {
            let mut message = twist(0);
            message.header.frame_id = frame.to_owned();
            assert_eq!(code(JUDGE.velocity(&message, NOW)), Some(Code::Invalid));
        }
        let mut message = drive(0);
        message.header.frame_id.clear();
        assert!(JUDGE.drive(&message, NOW).is_ok());
        message.header.frame_id = "world".to_owned();
        assert_eq!(code(JUDGE.drive(&message, NOW)), Some(Code::Invalid));
    }

    #[test]
    fn what_the_car_does_not_offer_is_refused_and_not_ignored() {
        let mut message = twist(0);
        message.angular.z = 0.1;
        assert_eq!(code(JUDGE.velocity(&message, NOW)), Some(Code::Invalid));
        message.angular.z = f64::NAN;
        assert_eq!(code(JUDGE.velocity(&message, NOW)), Some(Code::NotFinite));
        let mut message = drive(0);
        message.acceleration = 1.0;
        assert_eq!(code(JUDGE.drive(&message, NOW)), Some(Code::Invalid));
        message.speed = f32::INFINITY;
        assert_eq!(code(JUDGE.drive(&message, NOW)), Some(Code::NotFinite));
    }

    fn path(points: &[(i128, [f64; 2])]) -> Path {
        Path {
            header: header(0, "world"),
            poses: points
                .iter()
                .map(|&(after_ms, [x, y])| PoseStamped {
                    header: header(-after_ms, ""),
                    position: Vector3 { x, y, z: 0.0 },
                    orientation: [0.0, 0.0, 0.0, 1.0],
                })
                .collect(),
        }
    }

    #[test]
    fn a_path_has_the_velocities_of_its_parabolas() {
        // x = t^2, y = 2 t, with uneven steps.
        let points: Vec<_> = [0, 100, 300, 400]
            .map(|ms: i128| {
                let time = ms as f64 * 1e-3;
                (ms, [time * time, 2.0 * time])
            })
            .to_vec();
        let trajectory = JUDGE.path(&path(&points), NOW).unwrap().trajectory.unwrap();
        assert_eq!(trajectory[1].time_ns, 7_100_000_000);
        for (point, expected) in trajectory.iter().zip([0.1, 0.2, 0.6, 0.7]) {
            let [x, y] = point.velocity_m_s;
            assert!((x - expected).abs() < 1e-9, "{x} is not {expected}");
            assert!((y - 2.0).abs() < 1e-9, "{y}");
        }
    }

    #[test]
    fn a_path_without_order_or_with_too_many_points_is_refused() {
        let here = [0.0, 0.0];
        for points in [
            vec![],
            vec![(0, here)],
            vec![(0, here), (0, here)],
            vec![(10, here), (0, here)],
            (0..101).map(|ms| (ms, here)).collect(),
        ] {
            assert_eq!(
                code(JUDGE.path(&path(&points), NOW)),
                Some(Code::OutOfRange)
            );
        }
        let infinite = path(&[(0, here), (1, [f64::INFINITY, 0.0])]);
        assert_eq!(code(JUDGE.path(&infinite, NOW)), Some(Code::NotFinite));
    }

    /// Numbers of every kind, from a fixed seed.
    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 1_u64;
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            match state >> 61 {
                0 => f64::NAN,
                1 => f64::INFINITY,
                2 => f64::from_bits(state),
                3 | 4 => 0.0,
                _ => (state >> 40) as f64 * 1e-7,
            }
        }
    }

    #[test]
    fn whatever_a_message_holds_a_set_point_is_finite_and_neither_old_nor_of_the_future() {
        let mut number = numbers();
        let mut passed = 0;
        for round in 0..20_000_i128 {
            let vector = |number: &mut dyn FnMut() -> f64| Vector3 {
                x: number(),
                y: number(),
                z: number(),
            };
            // Of 1970, near now, years ahead.
            let wall = match round % 4 {
                0 => (number() * 1e9) as i128,
                1 => NOW.wall.saturating_add((number() * 1e18) as i128),
                _ => NOW.wall.saturating_sub((number() * 1e9) as i128),
            };
            let header = Header {
                stamp: Time::from_ns(wall.clamp(0, i128::from(i32::MAX) * 1_000_000_000)),
                frame_id: "world".to_owned(),
            };
            let twist = TwistStamped {
                header: header.clone(),
                linear: vector(&mut number),
                angular: vector(&mut number),
            };
            let drive = AckermannDriveStamped {
                header: Header {
                    frame_id: String::new(),
                    ..header.clone()
                },
                steering_angle: number() as f32,
                speed: number() as f32,
                acceleration: number() as f32,
                ..AckermannDriveStamped::default()
            };
            let mut path = path(&[(0, [number(), number()]), (1, [number(), number()])]);
            path.header = header;
            for setpoint in [
                JUDGE.velocity(&twist, NOW),
                JUDGE.drive(&drive, NOW),
                JUDGE.path(&path, NOW),
            ] {
                let Ok(setpoint) = setpoint else { continue };
                passed += 1;
                let time_ns = i128::from(setpoint.time_ns.unwrap());
                assert!((NOW.monotonic - 100 * MS..=NOW.monotonic).contains(&time_ns));
                let points = setpoint.trajectory.iter().flatten();
                let numbers = points
                    .flat_map(|point| point.position_m.into_iter().chain(point.velocity_m_s))
                    .chain(setpoint.velocity_m_s.into_iter().flatten())
                    .chain(setpoint.steering_rad)
                    .chain(setpoint.speed_m_s);
                assert!(numbers.into_iter().all(f64::is_finite), "{setpoint:?}");
            }
        }
        assert!(passed > 500, "{passed}");
    }
}
