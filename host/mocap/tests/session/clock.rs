//! When a frame was captured, on the local clock.

use proptest::prelude::*;
use singletrack_mocap::{
    CaptureTimeSource, RestartReason, SessionEvent,
    codec::{BitstreamVersion, CameraTicks},
    planar::{PlanarPose, PoseState, RejectReason},
};

use crate::{Frame, MS, Outcome, S, TICKS_PER_SECOND, UNICAST, World, config, jitter};

#[track_caller]
fn valid(state: PoseState) -> PlanarPose {
    match state {
        PoseState::Valid(pose) => pose,
        other => panic!("not valid: {other:?}"),
    }
}

/// Error of the capture time: frames are captured 8 ms before they are delivered.
fn error_ns(pose: &PlanarPose) -> u64 {
    pose.capture_time_ns.abs_diff(pose.receive_time_ns - 8 * MS)
}

/// Streams these frames and returns the poses.
fn stream(world: &mut World, frames: std::ops::Range<i32>) -> Vec<PlanarPose> {
    frames
        .map(|number| valid(world.next_state(&Frame::at_rest(number))))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_error_stays_within_the_stated_uncertainty(
        skew_ppm in -150.0..150.0_f64,
        there_ns in 0..2 * MS,
        back_ns in 0..2 * MS,
        seed: u64,
    ) {
        let mut world = World::new(config(UNICAST));
        world.server.skew_ppm = skew_ppm;
        let mut random = jitter(seed);
        world.network = Box::new(move |to_server| {
            let jitter_ns = if to_server { there_ns } else { back_ns };
            Some(20_000 + random(jitter_ns))
        });
        world.run(50 * MS);
        let poses = stream(&mut world, 0..3_000);
        for pose in poses.iter().skip(10) {
            prop_assert_eq!(pose.capture_source, CaptureTimeSource::MidExposureEcho);
            prop_assert!(
                error_ns(pose) <= pose.capture_uncertainty_ns,
                "frame {}: off by {} ns, stated {} ns",
                pose.frame_number,
                error_ns(pose),
                pose.capture_uncertainty_ns
            );
        }
    }
}

#[test]
fn drift_of_50_ppm_and_asymmetric_jitter_leave_less_than_a_typical_half_round_trip() {
    let mut world = World::new(config(UNICAST));
    world.server.skew_ppm = 50.0;
    let mut random = jitter(1);
    // There: 50 to 150 us. Back: 50 us to 1.05 ms.
    world.network =
        Box::new(move |to_server| Some(50_000 + random(if to_server { 100_000 } else { MS })));
    world.run(50 * MS);
    stream(&mut world, 0..2_000);
    let poses = stream(&mut world, 2_000..4_000);
    let worst_ns = poses.iter().map(error_ns).max().unwrap();
    let stated_ns = poses
        .iter()
        .map(|pose| pose.capture_uncertainty_ns)
        .max()
        .unwrap();
    assert!(worst_ns <= stated_ns, "{worst_ns} > {stated_ns}");
    // The mean round trip is 0.7 ms.
    assert!(stated_ns < 250_000, "{stated_ns}");
}

#[test]
fn without_echoes_the_source_is_the_least_delay() {
    let mut world = World::new(config(UNICAST));
    world.server.answers_echo = false;
    world.server.skew_ppm = 50.0;
    world.run(50 * MS);
    for pose in stream(&mut world, 0..1_000) {
        assert_eq!(pose.capture_source, CaptureTimeSource::MidExposureMinDelay);
        assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
    }
}

/// A stamp of no clock: no number, of 1970, of the epoch's seconds, beyond any clock.
fn strange_stamp() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(0.0),
        Just(-1.0),
        Just(1.8e9),
        Just(f64::MAX),
        any::<f64>(),
    ]
}

fn strange_ticks() -> impl Strategy<Value = u64> {
    prop_oneof![Just(0), Just(1), Just(u64::MAX), any::<u64>()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// With and without the clock of the server's ticks.
    #[test]
    fn stamps_that_make_no_sense_date_no_pose_into_the_future_and_are_survived(
        strange in proptest::collection::vec(
            (strange_stamp(), proptest::option::of((strange_ticks(), strange_ticks())), 0..6_usize),
            1..40,
        ),
        period_ms in 2..20_u64,
        has_ticks: bool,
    ) {
        let mut world = World::new(config(UNICAST));
        if !has_ticks {
            world.server.native = [2, 9];
        }
        world.run(50 * MS);
        let mut number = 0;
        let mut send = |world: &mut World, stamp, ticks: Option<(u64, u64)>| {
            number += 1;
            let frame = Frame {
                timestamp_s: stamp,
                ticks: ticks.map(|(mid_exposure, transmit)| CameraTicks {
                    mid_exposure,
                    received: transmit,
                    transmit,
                }),
                ..Frame::at_rest(number)
            };
            world.run(period_ms * MS);
            match world.frame(&frame) {
                Outcome::Frame(observation) => match observation.state {
                    PoseState::Valid(pose) => Some(pose),
                    _ => None,
                },
                _ => None,
            }
        };
        for (stamp, ticks, good) in strange {
            let poses = core::iter::once((Some(stamp), ticks))
                .chain(core::iter::repeat_n((None, None), good));
            for (stamp, ticks) in poses {
                if let Some(pose) = send(&mut world, stamp, ticks) {
                    prop_assert!(pose.capture_time_ns <= pose.receive_time_ns, "{pose:?}");
                }
            }
        }
        let mut last = None;
        for _ in 0..5_000 / period_ms {
            last = send(&mut world, None, None);
        }
        let pose = last.ok_or_else(|| TestCaseError::fail("no pose 5 s later"))?;
        prop_assert!(
            error_ns(&pose) <= pose.capture_uncertainty_ns,
            "off by {} ns, stated {} ns",
            error_ns(&pose),
            pose.capture_uncertainty_ns
        );
    }
}

#[test]
fn without_mid_exposure_the_source_is_the_timestamp() {
    let mut world = World::connected(config(UNICAST));
    for number in 0..500 {
        let mut frame = Frame::at_rest(number);
        frame.has_mid_exposure = false;
        let pose = valid(world.next_state(&frame));
        assert_eq!(pose.capture_source, CaptureTimeSource::FrameTimestamp);
        assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
    }
}

#[test]
fn before_3_0_the_source_is_the_timestamp_and_no_echo_is_sent() {
    let mut world = World::new(config(UNICAST));
    world.server.native = [2, 9];
    world.run(50 * MS);
    assert_eq!(world.server.stream, BitstreamVersion::V2_9);
    for pose in stream(&mut world, 0..500) {
        assert_eq!(pose.capture_source, CaptureTimeSource::FrameTimestamp);
        assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
    }
    assert_eq!(world.count_sent(&crate::Sent::Echo), 0);
}

#[test]
fn queued_frames_released_at_once_keep_their_age() {
    let mut world = World::connected(config(UNICAST));
    stream(&mut world, 0..100);
    let queue: Vec<_> = (100..150)
        .map(|number| {
            world.run(10 * MS);
            (world.now_ns - 8 * MS, world.encode(&Frame::at_rest(number)))
        })
        .collect();
    for (truth_ns, bytes) in &queue {
        world.receive(bytes);
        let pose = valid(world.observations.last().unwrap().state);
        assert!(pose.capture_time_ns.abs_diff(*truth_ns) <= pose.capture_uncertainty_ns);
    }
}

#[test]
fn a_capture_time_is_never_in_the_future() {
    let mut world = World::connected(config(UNICAST));
    stream(&mut world, 0..100);
    // The frame arrives before it was captured: first slightly, then by far.
    let bytes = world.encode(&Frame::at_rest(100));
    world.now_ns -= 8 * MS + 20_000;
    world.receive(&bytes);
    let pose = valid(world.observations.last().unwrap().state);
    assert_eq!(pose.capture_time_ns, pose.receive_time_ns);
    assert_eq!(world.session.counters().session.capture_clamped, 1);

    world.now_ns += 18 * MS;
    let bytes = world.encode(&Frame::at_rest(101));
    world.now_ns -= 9 * MS;
    world.receive(&bytes);
    assert_eq!(
        world.observations.last().unwrap().state,
        PoseState::Rejected(RejectReason::CaptureTime)
    );
}

#[test]
fn an_echo_that_goes_backward_restarts_the_session() {
    let mut world = World::connected(config(UNICAST));
    stream(&mut world, 0..100);
    world.server.ticks_at_zero -= 1_000_000_000;
    world.run(S);
    assert!(
        world
            .events
            .contains(&SessionEvent::Restarted(RestartReason::ClockBackward))
    );
    let pose = valid(world.next_state(&Frame::at_rest(0)));
    assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
}

#[test]
fn an_echo_that_contradicts_the_others_replaces_them() {
    let mut world = World::connected(config(UNICAST));
    stream(&mut world, 0..100);
    // Frames of a clock that is farther ahead are not taken: see the next test.
    world.server.ticks_at_zero += 4 * TICKS_PER_SECOND / 10;
    for number in 100..200 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.clock_steps, 1);
    let pose = valid(world.next_state(&Frame::at_rest(200)));
    assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
}

#[test]
fn a_server_whose_clock_jumps_far_ahead_is_followed_by_a_new_session() {
    let mut world = World::connected(config(UNICAST));
    stream(&mut world, 0..100);
    world.server.ticks_at_zero += 100 * TICKS_PER_SECOND;
    for number in 100..400 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.restarts, 1);
    let pose = valid(world.next_state(&Frame::at_rest(400)));
    assert!(error_ns(&pose) <= pose.capture_uncertainty_ns);
}

#[test]
fn an_unsolicited_echo_is_counted_and_changes_nothing() {
    let mut world = World::connected(config(UNICAST));
    let before = world.session.counters().session;
    let mut forged = [0; 64];
    let len = singletrack_mocap::encode::echo_response(
        singletrack_mocap::codec::Echo {
            client_stamp: 1,
            server_ticks: 1,
        },
        &mut forged,
    )
    .unwrap();
    world.receive(&forged[..len]);
    let after = world.session.counters().session;
    assert_eq!(after.unsolicited, before.unsolicited + 1);
    assert_eq!(after.echoes, before.echoes);
}
