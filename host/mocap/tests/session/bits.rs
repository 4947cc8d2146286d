//! Observations keep their bits: records of one release replay in the next.

use singletrack_mocap::{
    UpAxis,
    codec::RigidBody,
    planar::{PlanarPose, PoseState},
};

use crate::world::{CAR, Frame, MS, UNICAST, World, config, jitter};

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
