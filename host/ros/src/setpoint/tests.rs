//! Set-points of ROS messages: their ages, their frames and what is refused.

use super::*;
use crate::message::{PoseStamped, Vector3};

fn judge() -> Judge {
    let [map, odom, base] = ["map", "odom", "base_link"].map(str::to_owned);
    Judge {
        max_age: Duration::from_millis(100),
        frames: Frames { map, odom, base },
    }
}

const MS: i128 = 1_000_000;
const NOW: Now = Now {
    monotonic: 7_000_000_000,
    wall: 1_700_000_000_000_000_000,
};

const ARRIVED: Arrival = Arrival {
    now: NOW,
    sent: None,
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
        header: header(age_ms, "map"),
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
        judge().velocity(&twist(30), &ARRIVED).unwrap(),
        Setpoint {
            velocity_m_s: Some([0.5, -0.25]),
            time_ns: Some(6_970_000_000),
            ..Setpoint::default()
        }
    );
}

#[test]
fn a_drive_is_steering_and_speed_of_the_rear_axle_in_whatever_frame() {
    let expected = Setpoint {
        steering_rad: Some(0.25),
        rear_speed_m_s: Some(1.5),
        time_ns: Some(7_000_000_000),
        ..Setpoint::default()
    };
    for frame in ["base_link", "", "laser", "ego_racecar/base_link"] {
        let mut message = drive(0);
        message.header.frame_id = frame.to_owned();
        assert_eq!(judge().drive(&message, &ARRIVED).unwrap(), expected);
        assert_eq!(ignored_of_drive(&message).iter().flatten().count(), 0);
    }
}

#[test]
fn of_a_drive_the_steering_velocity_is_a_limit_and_acceleration_and_jerk_are_ignored() {
    for (velocity, limit) in [(0.5, Some(0.5)), (-0.5, Some(0.5)), (f32::MAX, None)] {
        let mut message = drive(0);
        message.steering_angle_velocity = velocity;
        message.acceleration = 1.0;
        message.jerk = f32::NAN;
        let setpoint = judge().drive(&message, &ARRIVED).unwrap();
        assert_eq!(setpoint.steering_rate_rad_s, limit);
        assert_eq!(setpoint.acceleration_m_s2, None);
        let warnings: Vec<_> = ignored_of_drive(&message).into_iter().flatten().collect();
        assert!(warnings[0].contains("acceleration") && warnings[1].contains("jerk"));
    }
    let mut message = drive(0);
    message.speed = f32::INFINITY;
    assert_eq!(
        code(judge().drive(&message, &ARRIVED)),
        Some(Code::NotFinite)
    );
}

#[test]
fn a_twist_of_the_car_is_steered_by_the_wheelbase() {
    let car = Car::of("vehicle = { front_axle_distance_m = 0.15, rear_axle_distance_m = 0.1 }");
    for (speed, yaw_rate, steering) in [
        (0.5, 0.4, libm::atan(0.2)),
        (-0.5, 0.4, -libm::atan(0.2)),
        (0.5, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (0.0, -1.0, -core::f64::consts::FRAC_PI_2),
    ] {
        let mut message = twist(0);
        message.header.frame_id = "odom".to_owned();
        message.linear = Vector3 {
            x: speed,
            y: 0.1,
            z: 0.0,
        };
        message.angular.z = yaw_rate;
        let setpoint = judge().twist(&message, car, &ARRIVED).unwrap();
        assert_eq!(setpoint.rear_speed_m_s, Some(speed));
        let steers = setpoint.steering_rad.unwrap();
        assert!((steers - steering).abs() < 1e-12, "{steers}");
        let warnings: Vec<_> = ignored_of_twist(&message).into_iter().flatten().collect();
        assert!(warnings[0].contains("are ignored"));
        assert_eq!(warnings.len() == 2, speed == 0.0 && yaw_rate != 0.0);
    }
    let unknown = judge().twist(&twist(0), None, &ARRIVED);
    assert_eq!(code(unknown), Some(Code::NotReady));
}

#[test]
fn without_a_stamp_a_drive_is_as_old_as_its_sending() {
    let mut message = drive(0);
    message.header = Header::default();
    let sent = |age_ms: i128| Arrival {
        now: NOW,
        sent: Some(NOW.wall - age_ms * MS),
    };
    let setpoint = judge().drive(&message, &sent(30)).unwrap();
    assert_eq!(setpoint.time_ns, Some(6_970_000_000));
    assert_eq!(code(judge().drive(&message, &sent(101))), Some(Code::Old));
    assert!(judge().drive(&message, &ARRIVED).is_ok());
}

#[test]
fn stamps_decide_to_the_millisecond() {
    assert!(judge().velocity(&twist(100), &ARRIVED).is_ok());
    assert_eq!(
        code(judge().velocity(&twist(101), &ARRIVED)),
        Some(Code::Old)
    );
    assert_eq!(
        code(judge().drive(&drive(1_000), &ARRIVED)),
        Some(Code::Old)
    );
    assert_eq!(
        code(judge().velocity(&twist(-6), &ARRIVED)),
        Some(Code::Future)
    );
    let ahead = judge().velocity(&twist(-5), &ARRIVED).unwrap();
    assert_eq!(ahead.time_ns, Some(7_000_000_000), "never in the future");
    let mut none = twist(0);
    none.header.stamp = Time::default();
    assert_eq!(code(judge().velocity(&none, &ARRIVED)), Some(Code::Invalid));
}

#[test]
fn velocities_and_paths_are_in_the_frame_of_the_motion_capture() {
    for (frame, is_taken) in [
        ("map", true),
        ("odom", true),
        ("world", true),
        ("", false),
        ("base_link", false),
    ] {
        let mut message = twist(0);
        message.header.frame_id = frame.to_owned();
        let refused = (!is_taken).then_some(Code::Invalid);
        assert_eq!(
            code(judge().velocity(&message, &ARRIVED)),
            refused,
            "{frame}"
        );
    }
}

#[test]
fn what_a_velocity_of_p_does_not_have_is_refused_and_not_ignored() {
    let mut message = twist(0);
    message.angular.z = 0.1;
    assert_eq!(
        code(judge().velocity(&message, &ARRIVED)),
        Some(Code::Invalid)
    );
    message.angular.z = f64::NAN;
    assert_eq!(
        code(judge().velocity(&message, &ARRIVED)),
        Some(Code::NotFinite)
    );
}

fn path(points: &[(i128, [f64; 2])]) -> Path {
    Path {
        header: header(0, "map"),
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
    let trajectory = judge()
        .path(&path(&points), &ARRIVED)
        .unwrap()
        .trajectory
        .unwrap();
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
            code(judge().path(&path(&points), &ARRIVED)),
            Some(Code::OutOfRange)
        );
    }
    let infinite = path(&[(0, here), (1, [f64::INFINITY, 0.0])]);
    assert_eq!(
        code(judge().path(&infinite, &ARRIVED)),
        Some(Code::NotFinite)
    );
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
    let car = Car::of("vehicle = { front_axle_distance_m = 0.15, rear_axle_distance_m = 0.1 }");
    let mut number = numbers();
    let mut passed = 0;
    for round in 0..20_000_i128 {
        let vector = |number: &mut dyn FnMut() -> f64| Vector3 {
            x: number(),
            y: number(),
            z: number(),
        };
        // Stamps of 1970, near now, and years ahead.
        let wall = match round % 4 {
            0 => (number() * 1e9) as i128,
            1 => NOW.wall.saturating_add((number() * 1e18) as i128),
            _ => NOW.wall.saturating_sub((number() * 1e9) as i128),
        };
        let header = Header {
            stamp: Time::from_ns(wall.clamp(0, i128::from(i32::MAX) * 1_000_000_000)),
            frame_id: "odom".to_owned(),
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
            judge().velocity(&twist, &ARRIVED),
            judge().drive(&drive, &ARRIVED),
            judge().path(&path, &ARRIVED),
            judge().twist(&twist, car, &ARRIVED),
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
                .chain(setpoint.rear_speed_m_s);
            assert!(numbers.into_iter().all(f64::is_finite), "{setpoint:?}");
        }
    }
    assert!(passed > 500, "{passed}");
}
