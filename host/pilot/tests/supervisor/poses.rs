//! Age and distance of the last pose.

use singletrack_pilot::{Mode, PilotRequest, Reason};

use crate::bench::Bench;

#[test]
fn a_pose_is_held_up_to_its_time_and_distance() {
    let mut bench = Bench::driving();
    bench.pose_age_ms = 300;
    bench.conditions.blind_distance = 0.15;
    assert_eq!(bench.step(), (Mode::Driving, None, None));
    bench.conditions.blind_distance = 0.151;
    assert_eq!(
        bench.step(),
        (Mode::Slowing, Some(Reason::BlindTooFar), None)
    );
}

#[test]
fn a_slowing_car_drives_on_after_three_fresh_poses_and_not_before() {
    let mut bench = Bench::slowing();
    for age_ms in [600, 299, 51] {
        bench.pose_age_ms = age_ms;
        assert_eq!(bench.step().0, Mode::Slowing, "{age_ms} ms");
    }
    bench.pose_age_ms = 50;
    for _ in 0..2 {
        // A single pose may be of another body.
        bench.conditions.poses += 1;
        assert_eq!(
            bench.step(),
            (Mode::Slowing, Some(Reason::PoseTooOld), None)
        );
    }
    bench.conditions.poses += 1;
    assert_eq!(bench.step(), (Mode::Driving, None, None));
    // The reason of the slowing does not stay.
    bench.ask(PilotRequest::Disarm);
    assert_eq!(bench.supervisor.reason(), Some(Reason::Requested));
}

#[test]
fn a_slowing_car_stops_for_good_beyond_its_blind_distance() {
    let mut bench = Bench::slowing();
    bench.pose_age_ms = 600;
    bench.conditions.blind_distance = 0.45;
    assert_eq!(bench.step().0, Mode::Slowing);
    bench.conditions.blind_distance = 0.451;
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::BlindTooFar), None)
    );
}

#[test]
fn a_slowing_car_at_rest_stops_for_good_beyond_its_blind_time() {
    let mut bench = Bench::slowing();
    bench.conditions.commanded_speed = 0.0;
    bench.pose_age_ms = 600;
    assert_eq!(bench.step().0, Mode::Slowing);
    bench.pose_age_ms = 601;
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::PoseTooOld), None)
    );
}

#[test]
fn an_estimate_that_restarted_while_slowing_needs_three_poses() {
    let mut bench = Bench::slowing();
    bench.pose_age_ms = 10;
    for (poses, mode) in [(1, Mode::Slowing), (2, Mode::Slowing), (3, Mode::Driving)] {
        bench.conditions.poses = poses;
        assert_eq!(bench.step().0, mode, "{poses}");
    }
}
