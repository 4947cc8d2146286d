use singletrack_mocap::UpAxis;

use super::*;

fn frames(parameters: CameraParameters, truth: Truth, until_us: u64) -> Vec<CameraFrame> {
    let mut cameras = Cameras::new(parameters, 1);
    while cameras.next_exposure_us < until_us {
        cameras.expose(&Truth {
            time_us: cameras.next_exposure_us,
            ..truth
        });
    }
    core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect()
}

fn exact() -> CameraParameters {
    CameraParameters {
        position_noise_m: 0.0,
        orientation_noise_rad: 0.0,
        clock_skew_ppm: 0,
        phase_us: 0,
        ..CameraParameters::default()
    }
}

#[test]
fn poses_are_streamed_in_the_selected_axes_about_the_pivot() {
    let truth = Truth {
        x: 1.0,
        y: 2.0,
        yaw: core::f64::consts::FRAC_PI_2,
        ..Truth::default()
    };
    let mut parameters = exact();
    parameters.car.to_centre_of_mass_m = [0.1, 0.0];
    let half = core::f32::consts::FRAC_1_SQRT_2;
    for (up_axis, position, attitude) in [
        (UpAxis::Y, [1.0, 0.12, -1.9], [0.0, half, 0.0, half]),
        (UpAxis::Z, [1.0, 1.9, 0.12], [0.0, 0.0, half, half]),
    ] {
        parameters.up_axis = up_axis;
        let frame = frames(parameters.clone(), truth, 1).remove(0);
        let car = frame.bodies.last().unwrap();
        for i in 0..3 {
            assert!((car.position_m[i] - position[i]).abs() < 1e-6, "{car:?}");
            assert!((car.orientation_xyzw[i] - attitude[i]).abs() < 1e-6);
        }
    }
}

#[test]
fn scheduled_losses_repeat_the_last_pose_without_the_tracking_bit() {
    let mut parameters = CameraParameters {
        loss: Some("200ms@2s".parse().unwrap()),
        ..CameraParameters::default()
    };
    parameters.clock_skew_ppm = 0;
    let frames = frames(parameters, Truth::default(), 5_000_000);
    let lost: Vec<_> = frames
        .iter()
        .filter(|frame| !frame.car_tracked)
        .map(|frame| frame.exposed_us)
        .collect();
    assert_eq!(lost.len(), 40);
    assert!(
        lost[..20]
            .iter()
            .all(|us| (2_000_000..2_200_000).contains(us))
    );
    assert!(
        lost[20..]
            .iter()
            .all(|us| (4_000_000..4_200_000).contains(us))
    );
    let first = frames.iter().position(|frame| !frame.car_tracked).unwrap();
    let (before, after) = (frames[first - 1].bodies[2], frames[first + 5].bodies[2]);
    assert!(before.tracking_valid() && !after.tracking_valid());
    assert_eq!(before.position_m, after.position_m);
}

#[test]
fn losses_can_be_absent_or_silent_and_start_at_their_epoch() {
    let window = LossWindow {
        start_us: 100_000,
        end_us: 200_000,
    };
    let mut cameras = Cameras::new(exact(), 1);
    cameras.parameters.loss_windows.push(window);
    cameras.loss_epoch_us = Some(1_000_000);
    cameras.parameters.loss_kind = LossKind::Absent;
    for _ in 0..200 {
        let time_us = cameras.next_exposure_us;
        cameras.expose(&Truth {
            time_us,
            ..Truth::default()
        });
    }
    let frames: Vec<_> = core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect();
    for frame in &frames {
        let lost = (1_100_000..1_200_000).contains(&frame.exposed_us);
        assert_eq!(frame.bodies.len(), if lost { 2 } else { 3 });
    }
    assert_eq!(cameras.counters.lost, 10);
    assert_eq!(cameras.counters.sent, 200);

    cameras.faults.loss = Some(LossKind::Silent);
    let time_us = cameras.next_exposure_us;
    cameras.expose(&Truth {
        time_us,
        ..Truth::default()
    });
    assert!(cameras.take_frame(u64::MAX).unwrap().silent);
    assert_eq!(cameras.counters.sent, 200);
}

#[test]
fn noise_and_latency_have_the_configured_size() {
    let frames = frames(CameraParameters::default(), Truth::default(), 100_000_000);
    let n = frames.len() as f64;
    let sum = |f: &dyn Fn(&CameraFrame) -> f64| frames.iter().map(f).sum::<f64>() / n;
    let x = sum(&|frame| f64::from(frame.bodies[2].position_m[0]).powi(2));
    assert!((x.sqrt() - 0.000_2).abs() < 0.000_01, "{x}");
    let yaw = sum(&|frame| (2.0 * f64::from(frame.bodies[2].orientation_xyzw[1])).powi(2));
    assert!((yaw.sqrt() - 0.001_745).abs() < 0.000_1, "{yaw}");
    let latency = sum(&|frame| (frame.sent_us - frame.exposed_us) as f64);
    assert!((latency - 8_000.0).abs() < 20.0, "{latency}");
    assert!(
        frames
            .windows(2)
            .all(|pair| pair[0].sent_us <= pair[1].sent_us)
    );
}

#[test]
fn faults_that_keep_the_tracking_bit_are_on_the_wire() {
    let mut cameras = Cameras::new(exact(), 1);
    let next = |cameras: &mut Cameras| {
        let time_us = cameras.next_exposure_us;
        cameras.expose(&Truth {
            time_us,
            ..Truth::default()
        });
        cameras.take_frame(u64::MAX).unwrap()
    };
    cameras.faults.jump_m = [0.5, 0.0, 0.0];
    let car = next(&mut cameras).bodies[2];
    assert!(car.tracking_valid() && (car.position_m[0] - 0.5).abs() < 1e-6);
    cameras.faults = CameraFaults {
        swapped: true,
        ..CameraFaults::default()
    };
    let bodies = next(&mut cameras).bodies;
    assert_eq!((bodies[0].id, bodies[2].id), (11, 3));
    cameras.faults = CameraFaults {
        not_a_number: true,
        ..CameraFaults::default()
    };
    assert!(next(&mut cameras).bodies[2].position_m[0].is_nan());
}

/// The frames of a car that drives along x with 1 m/s for two seconds.
fn driven(change: impl FnOnce(&mut CameraParameters)) -> (Cameras, Vec<CameraFrame>) {
    let mut parameters = exact();
    change(&mut parameters);
    let mut cameras = Cameras::new(parameters, 1);
    while cameras.next_exposure_us < 2_000_000 {
        let time_us = cameras.next_exposure_us;
        cameras.expose(&Truth {
            time_us,
            x: time_us as f64 * 1e-6,
            ..Truth::default()
        });
    }
    let frames = core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect();
    (cameras, frames)
}

fn x(frame: &CameraFrame) -> f64 {
    frame.bodies.last().unwrap().position_m[0].into()
}

#[test]
fn a_late_stamp_is_on_an_older_pose() {
    for (bias_ms, drift_ppm) in [(20.0, 0.0), (-20.0, 0.0), (0.0, 1_000.0)] {
        let (cameras, frames) = driven(|p| {
            (p.stamp_bias_ms, p.stamp_drift_ppm) = (bias_ms, drift_ppm);
        });
        for frame in frames {
            let error_us = bias_ms * 1e3 + drift_ppm * 1e-6 * frame.exposed_us as f64;
            let error = frame.ticks.mid_exposure as f64 - cameras.ticks(frame.exposed_us) as f64;
            assert!((error - error_us * 10.0).abs() <= 1.0, "{error}");
            // No stamp is in the future of its packet.
            assert!(frame.ticks.mid_exposure < frame.ticks.transmit);
        }
    }
}

#[test]
fn frozen_poses_repeat_in_new_frames() {
    let (_, frames) = driven(|p| (p.frozen_from_s, p.frozen_ms) = (Some(1.0), 500.0));
    for frame in &frames {
        let seen_us = match frame.exposed_us {
            at @ 1_000_000..1_500_000 => at.min(990_000),
            at => at,
        };
        assert!((x(frame) - seen_us as f64 * 1e-6).abs() < 1e-6);
        assert!(frame.car_tracked && frame.bodies.last().unwrap().tracking_valid());
    }
    assert!(
        frames
            .windows(2)
            .all(|pair| pair[0].number < pair[1].number)
    );
}

#[test]
fn a_flip_lasts_and_another_body_stands_still() {
    let (_, frames) = driven(|p| p.flip_from_s = Some(1.0));
    for frame in &frames {
        // Up is y: half the yaw's sine.
        let half = f64::from(frame.bodies.last().unwrap().orientation_xyzw[1]);
        let expected = if frame.exposed_us < 1_000_000 {
            0.0
        } else {
            1.0
        };
        assert!((half - expected).abs() < 1e-6);
        assert!((x(frame) - frame.exposed_us as f64 * 1e-6).abs() < 1e-6);
    }
    let (_, frames) = driven(|p| p.other_body_from_s = Some(1.0));
    let decoy = CameraParameters::default().decoys[0].position_m;
    for frame in &frames {
        let expected = match frame.exposed_us {
            at @ ..1_000_000 => at as f64 * 1e-6,
            _ => decoy[0],
        };
        assert!((x(frame) - expected).abs() < 1e-6);
    }
}

#[test]
fn forged_frames_follow_the_true_ones_and_drift_away() {
    let (cameras, frames) = driven(|p| {
        p.forged_from_s = Some(0.5);
        p.forged_offset_m = [0.1, -0.2];
        p.forged_drift_m_s = [0.0, 1.0];
    });
    assert_eq!(cameras.forge(&frames[10]), None);
    let last = frames.last().unwrap();
    let forged = cameras.forge(last).unwrap();
    assert_eq!(forged.number, last.number + 1);
    assert!(forged.ticks.mid_exposure > last.ticks.mid_exposure);
    let [x, _, minus_y] = forged.bodies.last().unwrap().position_m;
    let elapsed_s = last.sent_us as f64 * 1e-6 - 0.5;
    assert!((f64::from(x) - (last.exposed_us as f64 * 1e-6 + 0.1)).abs() < 1e-6);
    assert!((f64::from(-minus_y) - (elapsed_s - 0.2)).abs() < 1e-6);
}

#[test]
fn nothing_timed_happens_before_its_epoch() {
    let mut cameras = Cameras::new(
        CameraParameters {
            flip_from_s: Some(0.0),
            ..exact()
        },
        1,
    );
    let mut half = |epoch| {
        cameras.epoch = Epoch(epoch);
        let time_us = cameras.next_exposure_us;
        cameras.expose(&Truth {
            time_us,
            ..Truth::default()
        });
        let frame = cameras.take_frame(u64::MAX).unwrap();
        frame.bodies.last().unwrap().orientation_xyzw[1]
    };
    assert!(half(None).abs() < 1e-6);
    assert!(half(Some(1_000_000)).abs() < 1e-6);
    assert!((half(Some(0)) - 1.0).abs() < 1e-6);
}
