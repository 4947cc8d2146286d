//! Which poses are accepted. Observations keep their bits: records of one release replay in the next.

use std::{
    f32::consts::{FRAC_1_SQRT_2, PI},
    f64::consts::FRAC_PI_2,
};

use singletrack_mocap::{
    UpAxis,
    codec::RigidBody,
    planar::{PlanarPose, PoseState, RejectReason},
};

use crate::{CAR, Frame, MS, S, UNICAST, World, car_at, car_heading, config, jitter};

const LEVEL: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

#[track_caller]
fn valid(state: PoseState) -> PlanarPose {
    match state {
        PoseState::Valid(pose) => pose,
        other => panic!("not valid: {other:?}"),
    }
}

/// A connected world that has seen the car at rest in frame 0.
fn world_with_car() -> World {
    let mut world = World::connected(config(UNICAST));
    valid(world.next_state(&Frame::at_rest(0)));
    world
}

#[track_caller]
fn assert_rejected(body: RigidBody, reason: RejectReason) {
    let mut world = world_with_car();
    assert_eq!(
        world.next_state(&Frame::new(1, &[body])),
        PoseState::Rejected(reason)
    );
    assert_eq!(world.session.counters().rejected.total(), 1);
    valid(world.next_state(&Frame::at_rest(2)));
}

#[test]
fn a_valid_pose_carries_the_values_of_the_frame() {
    let mut world = world_with_car();
    let mut body = car_heading(0.3);
    body.position_m = [0.01, -0.02, 0.05];
    body.mean_error_m = 0.000_2;
    let pose = valid(world.next_state(&Frame::new(1, &[body])));
    assert!((pose.x_m - 0.01).abs() < 1e-7);
    assert!((pose.y_m + 0.02).abs() < 1e-7);
    assert!((pose.z_m - 0.05).abs() < 1e-7);
    assert!((pose.yaw_rad - 0.3).abs() < 1e-6);
    assert!(pose.tilt_rad.abs() < 1e-6);
    assert!((pose.mean_error_m - 0.000_2).abs() < 1e-9);
    assert_eq!(pose.frame_number, 1);
    assert_eq!(pose.receive_time_ns, world.now_ns);
    assert!(!pose.reacquired);
}

#[test]
fn y_up_turns_position_and_attitude_alike() {
    let mut y_up = config(UNICAST);
    y_up.session.up_axis = UpAxis::Y;
    let mut world = World::connected(y_up);
    // Stream: 1 m along x, 0.1 m up, 2 m along z; a quarter turn about y.
    let body = RigidBody::tracked(
        CAR,
        [1.0, 0.1, 2.0],
        [0.0, FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2],
    );
    let pose = valid(world.next_state(&Frame::new(1, &[body])));
    assert!((pose.x_m - 1.0).abs() < 1e-6);
    assert!((pose.y_m + 2.0).abs() < 1e-6);
    assert!((pose.z_m - 0.1).abs() < 1e-6);
    assert!((pose.yaw_rad - FRAC_PI_2).abs() < 1e-6);
    assert!(pose.tilt_rad < 1e-6);
    assert!(pose.reacquired, "the first pose continues nothing");
}

#[test]
fn untracked_and_absent_are_not_poses() {
    let mut world = world_with_car();
    let lost = car_at(0.0, 0.0).with_tracking_valid(false);
    assert_eq!(
        world.next_state(&Frame::new(1, &[lost])),
        PoseState::Untracked
    );
    assert_eq!(world.next_state(&Frame::new(2, &[])), PoseState::Absent);
    let mut other = car_at(0.0, 0.0);
    other.id = 3;
    assert_eq!(
        world.next_state(&Frame::new(3, &[other])),
        PoseState::Absent
    );
    let counters = world.session.counters();
    assert_eq!((counters.untracked, counters.absent), (1, 2));
    assert!(!valid(world.next_state(&Frame::at_rest(4))).reacquired);
}

#[test]
fn numbers_that_are_not_finite_are_rejected() {
    for index in 0..3 {
        let mut body = car_at(0.0, 0.0);
        body.position_m[index] = f32::NAN;
        assert_rejected(body, RejectReason::NotFinite);
    }
    for index in 0..4 {
        let mut body = car_at(0.0, 0.0);
        body.orientation_xyzw[index] = f32::INFINITY;
        assert_rejected(body, RejectReason::NotFinite);
    }
    let mut body = car_at(0.0, 0.0);
    body.mean_error_m = f32::NAN;
    assert_rejected(body, RejectReason::NotFinite);
}

#[test]
fn a_quaternion_whose_norm_is_not_one_is_rejected() {
    for quaternion in [[0.0; 4], [0.0, 0.0, 0.0, 1.02], [1.0, 1.0, 1.0, 1.0]] {
        let body = RigidBody::tracked(CAR, [0.0; 3], quaternion);
        assert_rejected(body, RejectReason::NotUnitQuaternion);
    }
}

#[test]
fn a_large_marker_error_is_rejected() {
    let mut body = car_at(0.0, 0.0);
    body.mean_error_m = 0.005_1;
    assert_rejected(body, RejectReason::MeanError);
}

#[test]
fn an_id_of_two_bodies_is_rejected() {
    let mut world = world_with_car();
    let frame = Frame::new(1, &[car_at(0.0, 0.0), car_at(0.0, 0.0)]);
    assert_eq!(
        world.next_state(&frame),
        PoseState::Rejected(RejectReason::DuplicateId)
    );
}

#[test]
fn a_jump_faster_than_the_car_is_rejected() {
    // 5 m/s for 10 ms and 5 cm of margin.
    assert_rejected(car_at(0.11, 0.0), RejectReason::Jump);
    let mut world = world_with_car();
    valid(world.next_state(&Frame::new(1, &[car_at(0.09, 0.0)])));
}

#[test]
fn a_pose_captured_long_before_the_last_one_is_rejected_and_does_not_allow_a_jump() {
    let mut world = world_with_car();
    let mut old = Frame::at_rest(1);
    old.age_ns = 600 * S;
    let state = world.next_state(&old);
    assert_eq!(state, PoseState::Rejected(RejectReason::CaptureTime));
    // The car did not have ten minutes to get there.
    let state = world.next_state(&Frame::new(2, &[car_at(3.0, 0.0)]));
    assert_eq!(state, PoseState::Rejected(RejectReason::Jump));
    valid(world.next_state(&Frame::at_rest(3)));
}

#[test]
fn a_heading_that_flips_is_rejected() {
    assert_rejected(car_heading(PI), RejectReason::Flip);
    // A step across the branch cut is not a flip.
    let mut world = World::connected(config(UNICAST));
    valid(world.next_state(&Frame::new(1, &[car_heading(PI - 0.01)])));
    valid(world.next_state(&Frame::new(2, &[car_heading(0.01 - PI)])));
}

#[test]
fn an_up_axis_that_tips_over_is_rejected() {
    let tilted = |angle_rad: f32| {
        let (sin, cos) = (angle_rad / 2.0).sin_cos();
        RigidBody::tracked(CAR, [0.0, 0.0, 0.05], [sin, 0.0, 0.0, cos])
    };
    assert_rejected(tilted(0.51), RejectReason::Flip);
    assert_rejected(tilted(PI), RejectReason::Flip);
    let mut world = world_with_car();
    let pose = valid(world.next_state(&Frame::new(1, &[tilted(0.4)])));
    assert!((pose.tilt_rad - 0.4).abs() < 1e-6);
}

#[test]
fn many_rejects_lock_the_body_out_and_consistent_poses_end_the_lock_out() {
    let mut world = world_with_car();
    // So far away that the elapsed time does not explain the jump.
    let elsewhere = |number| Frame::new(number, &[car_at(30.0, 0.0)]);
    for number in 1..10 {
        assert_eq!(
            world.next_state(&elsewhere(number)),
            PoseState::Rejected(RejectReason::Jump)
        );
    }
    for number in 10..20 {
        assert_eq!(
            world.next_state(&elsewhere(number)),
            PoseState::LockedOut(RejectReason::Jump)
        );
    }
    let pose = valid(world.next_state(&elsewhere(20)));
    assert!(pose.reacquired);
    assert!((pose.x_m - 30.0).abs() < 1e-6);
    assert!(!valid(world.next_state(&elsewhere(21))).reacquired);
    assert_eq!(world.session.counters().rejected.of(RejectReason::Jump), 19);
    assert_eq!(world.session.counters().locked_out, 10);
}

#[test]
fn poses_that_disagree_with_each_other_never_end_the_lock_out() {
    let mut world = world_with_car();
    for number in 1..100 {
        let x_m = if number % 2 == 0 { 30.0 } else { -30.0 };
        let state = world.next_state(&Frame::new(number, &[car_at(x_m, 0.0)]));
        if number >= 10 {
            assert_eq!(state, PoseState::LockedOut(RejectReason::Jump));
        }
    }
    assert!(valid(world.next_state(&Frame::at_rest(100))).reacquired);
}

#[test]
fn a_silent_stream_is_stale_and_its_last_pose_is_not_passed_on() {
    let mut world = world_with_car();
    world.run(100 * MS);
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::Valid(_)
    ));
    assert_eq!(
        world.session.pose_state(world.now_ns + 1),
        PoseState::Stale {
            silent_ns: 100 * MS + 1
        }
    );
    world.run(100 * MS);
    assert_eq!(world.session.counters().session.stale, 1);
    valid(world.next_state(&Frame::new(
        1,
        &[RigidBody::tracked(CAR, [0.0, 0.0, 0.05], LEVEL)],
    )));
}

#[test]
fn a_wrong_up_axis_shows_in_height_and_tilt() {
    // Stream: a car that stands on the floor at (1, 2), height 0.1 m, yaw 60 degrees.
    let (half_sin, half_cos) = (30.0_f32.to_radians().sin(), 30.0_f32.to_radians().cos());
    let y_up = RigidBody::tracked(CAR, [1.0, 0.1, -2.0], [0.0, half_sin, 0.0, half_cos]);
    let z_up = RigidBody::tracked(CAR, [1.0, 2.0, 0.1], [0.0, 0.0, half_sin, half_cos]);
    for (axis, right, wrong) in [(UpAxis::Y, y_up, z_up), (UpAxis::Z, z_up, y_up)] {
        for (body, suggests) in [(right, false), (wrong, true)] {
            let mut config = config(UNICAST);
            config.session.up_axis = axis;
            let mut world = World::connected(config);
            world.next_state(&Frame::new(1, &[body]));
            let level = world.session.tracker().level.unwrap();
            assert_eq!(level.suggests_other_axis(), suggests, "{axis:?} {level:?}");
            let (height_m, tilt_rad) = if suggests {
                (level.other_height_m, level.other_tilt_rad)
            } else {
                (level.height_m, level.tilt_rad)
            };
            assert!((height_m - 0.1).abs() < 1e-6 && tilt_rad < 1e-3);
        }
    }
}

#[test]
fn a_wrong_up_axis_shows_in_the_height_alone_while_the_yaw_is_zero() {
    let mut y_up = config(UNICAST);
    y_up.session.up_axis = UpAxis::Y;
    let mut world = World::connected(y_up);
    let body = RigidBody::tracked(CAR, [1.0, 2.0, 0.1], [0.0, 0.0, 0.0, 1.0]);
    world.next_state(&Frame::new(1, &[body]));
    // Within the floor's height both are possible.
    assert!(world.session.tracker().level.unwrap().suggests_other_axis());
    let body = RigidBody::tracked(CAR, [1.0, 0.3, 0.1], [0.0, 0.0, 0.0, 1.0]);
    world.next_state(&Frame::new(2, &[body]));
    assert!(!world.session.tracker().level.unwrap().suggests_other_axis());
}

#[test]
fn other_bodies_are_told_only_where_asked_for() {
    let other = RigidBody::tracked(3, [1.0, 2.0, 0.3], [0.0, 0.0, 0.0, 1.0]);
    for tells_others in [false, true] {
        let mut config = config(UNICAST);
        config.tells_others = tells_others;
        let mut world = World::connected(config);
        world.next_state(&Frame::new(1, &[car_at(0.0, 0.0), other]));
        world.next_state(&Frame::new(
            2,
            &[other.with_tracking_valid(false), car_at(0.0, 0.0)],
        ));
        let told: Vec<_> = world
            .others
            .iter()
            .map(|told| (told.id, told.position_m))
            .collect();
        let expected = [(3, Some([1.0, 2.0])), (3, None)];
        assert_eq!(told, if tells_others { &expected[..] } else { &[] });
    }
}

/// FNV-1a over 64-bit words.
struct Digest(u64);

impl Digest {
    const fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0100_0000_01b3);
    }

    fn pose(&mut self, pose: &PlanarPose) {
        for value in [
            pose.x_m,
            pose.y_m,
            pose.z_m,
            pose.yaw_rad,
            pose.tilt_rad,
            pose.mean_error_m,
        ] {
            self.word(value.to_bits());
        }
        self.word(pose.capture_time_ns);
        self.word(pose.capture_uncertainty_ns);
        self.word(pose.receive_time_ns);
        self.word(u64::from(pose.frame_number.cast_unsigned()));
        self.word(pose.capture_source as u64);
        self.word(pose.reacquired.into());
    }

    fn state(&mut self, state: &PoseState) {
        match state {
            PoseState::Valid(pose) => self.pose(pose),
            PoseState::Untracked => self.word(1),
            PoseState::Absent => self.word(2),
            PoseState::Rejected(reason) => self.word(10 + *reason as u64),
            PoseState::LockedOut(reason) => self.word(20 + *reason as u64),
            other => panic!("not in a bound stream: {other:?}"),
        }
    }
}

/// A stream of 2000 random frames: turns, tilts, losses, jumps, bad quaternions.
fn digest(up_axis: UpAxis) -> (u64, u64) {
    let mut config = config(UNICAST);
    config.session.up_axis = up_axis;
    let mut world = World::new(config);
    world.server.skew_ppm = 37.0;
    let mut delay = jitter(3);
    world.network = Box::new(move |_| Some(50_000 + delay(400_000)));
    world.run(50 * MS);
    let mut random = jitter(11);
    let mut unit = move || random(1_000_000) as f32 / 500_000.0 - 1.0;
    let mut digest = Digest(0xcbf2_9ce4_8422_2325);
    let mut at_m = [0.0_f32; 3];
    let mut half_yaw = [1.0_f32, 0.0];
    for number in 0..2_000 {
        for value in &mut at_m {
            *value += 0.02 * unit();
        }
        let tilt = [0.15 * unit(), 0.15 * unit()];
        // Half the yaw as a complex number: no function whose bits depend on the platform.
        let turn = 0.02 + 0.02 * unit();
        half_yaw = [
            half_yaw[0] - turn * half_yaw[1],
            half_yaw[1] + turn * half_yaw[0],
        ];
        let length = (half_yaw[0] * half_yaw[0] + half_yaw[1] * half_yaw[1]).sqrt();
        half_yaw = half_yaw.map(|v| v / length);
        let quaternion = match up_axis {
            UpAxis::Z => [tilt[0], tilt[1], half_yaw[1], half_yaw[0]],
            UpAxis::Y => [tilt[0], half_yaw[1], tilt[1], half_yaw[0]],
        };
        let norm = quaternion.iter().map(|v| v * v).sum::<f32>().sqrt();
        let mut body = RigidBody::tracked(CAR, at_m, quaternion.map(|v| v / norm));
        body.mean_error_m = 0.003 * (1.0 + unit());
        let mut frame = Frame::new(number, &[body]);
        match number % 53 {
            7 => frame.bodies[0] = body.with_tracking_valid(false),
            19 => frame.bodies.clear(),
            23 => frame.bodies.push(body),
            31 => frame.bodies[0].position_m[0] += 5.0,
            37 => frame.bodies[0].orientation_xyzw[3] += 0.5,
            41 => frame.bodies[0].position_m[1] = f32::NAN,
            _ => {}
        }
        if (900..925).contains(&number) {
            frame.bodies.clear();
            body.position_m[0] += 10.0;
            frame.bodies.push(body);
        }
        frame.has_mid_exposure = number % 11 != 5;
        digest.state(&world.next_state(&frame));
    }
    (digest.0, world.session.counters().valid)
}

#[test]
fn observations_keep_their_bits() {
    assert_eq!(digest(UpAxis::Z), (0x4472_3727_f5d8_8f9b, 1_377));
    assert_eq!(digest(UpAxis::Y), (0x62c0_71d3_445a_514e, 1_377));
}
