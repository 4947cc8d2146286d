//! A car that has lost its markers is disarmed by the host, before the board must stop it; a car
//! that was stopped is armed again from where it stands.

use singletrack_core::{
    HostOptions,
    config::{Config, ReferenceSection, Start, StepSection},
    feasibility::{Severity, Stand, judge_reference},
};
use singletrack_pilot::{Arming, Mode, Output, PilotRequest, Reason};
use singletrack_record::{Entry, Replay};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::{VirtualDrive, VirtualTick},
};
use singletrack_sim::{LossWindow, SimulationConfig, StartPose};

const EXAMPLE: &str = include_str!("../../../host/daemon/singletrackd.example.toml");

fn eight(start: Start) -> ReferenceSection {
    ReferenceSection::FigureOfEight {
        half_length_m: 1.8,
        half_width_m: 0.9,
        angular_velocity_rad_s: 0.25,
        centre_m: [0.0, 0.0],
        start,
    }
}

/// The eight in a fence without much room around it.
fn on_the_eight(start: Start) -> Config {
    let mut config = daemon_config(Drive::following(eight(start)));
    let [x, y] = [2.6, 1.9];
    config.fence.corners_m = vec![[-x, -y], [x, -y], [x, y], [-x, y]];
    config
}

/// The example of the daemon, in its small fence.
fn on_the_circle() -> Config {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    config.motion_capture.server = [127, 0, 0, 1].into();
    config.supervisor.prove_first_metre = false;
    config.supervisor.require_calibration = false;
    config
}

fn stand(output: &Output) -> Stand {
    let estimate = output.estimate.unwrap();
    Stand {
        x_m: estimate.position.x,
        y_m: estimate.position.y,
        yaw_rad: estimate.yaw,
    }
}

/// Steps until the mode is this one, for 20 s at most.
fn until(drive: &mut VirtualDrive, mode: Mode) -> VirtualTick {
    for _ in 0..2_000 {
        let tick = drive.step();
        if tick.tick.output.mode == mode {
            return tick;
        }
    }
    let output = &drive.step().tick.output;
    panic!("{mode} expected: {} {:?}", output.mode, output.reason);
}

/// Drives from there, stops and arms again, once for each time (s): the entries of the record.
fn drives(config: &Config, start: StartPose, times: &[f64]) -> Vec<Entry> {
    let mut simulation = SimulationConfig::default();
    simulation.car.start = start;
    let mut drive = VirtualDrive::new(config.clone(), 1, simulation).unwrap();
    drive.keep_entries();
    for &time in times {
        let ready = until(&mut drive, Mode::Ready);
        // What the daemon asks before it arms.
        let from = stand(&ready.tick.output);
        let judged = judge_reference(config, Some(from), None).unwrap();
        assert!(judged.is_possible(), "{from}: {:?}", judged.findings);
        drive
            .request(PilotRequest::Arm(Arming::Unattended))
            .unwrap();
        let first = until(&mut drive, Mode::Driving);
        let output = &first.tick.output;
        let wanted = output.reference.unwrap().position.unwrap();
        let away = (wanted - output.point.unwrap()).norm();
        assert!(away < 0.25, "{away} m from P at {from}");
        while drive.now_us() < first.now.0 / 1_000 + (time * 1e6) as u64 {
            let output = drive.step().tick.output;
            assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
        }
        drive.request(PilotRequest::Disarm).unwrap();
        until(&mut drive, Mode::Idle);
    }
    drive.entries()
}

fn assert_replayed_to_the_bit(config: &Config, entries: &[Entry]) {
    let mut replay = Replay::new(config.pilot().unwrap());
    let ticks = entries.iter().filter_map(|entry| match entry {
        Entry::Tick(tick) => Some(tick),
        _ => None,
    });
    for tick in ticks {
        let output = replay.tick(tick).unwrap();
        assert!(tick.is_output(&output), "{:?}", tick.differences(&output));
    }
}

#[test]
fn a_car_on_the_circle_stops_and_is_armed_again_wherever_it_stands() {
    let config = on_the_circle();
    let start = StartPose {
        x_m: 0.57,
        y_m: -0.39,
        yaw_rad: 54_f64.to_radians(),
    };
    let entries = drives(&config, start, &[3.7, 6.1, 8.3, 12.9]);
    assert_replayed_to_the_bit(&config, &entries);
}

#[test]
fn a_car_on_an_eight_stops_and_is_armed_again_wherever_it_stands() {
    let config = on_the_eight(Start::Nearest);
    let start = StartPose {
        x_m: -0.344,
        y_m: -0.344,
        yaw_rad: core::f64::consts::FRAC_PI_4,
    };
    // The last drives begin at the crossing.
    let entries = drives(&config, start, &[4.3, 7.9, 10.7, 1.0, 12.4]);
    assert_replayed_to_the_bit(&config, &entries);
}

#[test]
fn from_the_beginning_a_car_that_has_driven_on_is_refused_with_a_place_from_which_it_works() {
    let config = on_the_eight(Start::Beginning);
    // A quarter of the eight, at its end.
    let here = Stand {
        x_m: 1.8,
        y_m: 0.1,
        yaw_rad: -1.4,
    };
    let judged = judge_reference(&config, Some(here), None).unwrap();
    let place = judged.start.unwrap();
    let mut impossible = judged
        .findings
        .iter()
        .filter(|finding| finding.severity == Severity::Impossible);
    let text = impossible.next().unwrap().to_string();
    assert!(
        text.starts_with("reference.start is beginning: from here"),
        "{text}"
    );
    let carry = format!("Carry it to ({:.2}, {:.2}) m, ", place.x_m, place.y_m);
    assert!(
        text.contains(&carry) && !text.contains("iden the fence"),
        "{text}"
    );
    let there = judge_reference(&config, Some(place), None).unwrap();
    assert!(there.is_possible(), "{:?}", there.findings);
}

/// A slow car, and the lowest age of a pose at which the board stops it that once passed the
/// check of the configuration: `blind_ms` and 150 ms.
fn config(period_ms: u32) -> Config {
    let mut config = daemon_config(Drive::following(ReferenceSection::VelocitySteps {
        steps: vec![StepSection {
            duration_s: 60.0,
            v_x_m_s: 0.3,
            v_y_m_s: 0.0,
        }],
    }));
    config.control.period_ms = period_ms;
    config.watch.max_gap_ms = 95;
    config.watch.max_missed_ticks_per_s = 15;
    config.limits.max_speed_m_s = 0.5;
    config.board.max_pose_age_ms = 750;
    config.fence.braking_m_s2 = 0.1;
    config
}

#[test]
fn the_host_disarms_a_rolling_car_without_poses_before_the_board_stops_it() {
    for period_ms in [10, 20, 45] {
        for loss_ms in (560..=840).step_by(20) {
            // The car rolls on at the command to stand, and has no brake.
            let mut simulation = SimulationConfig {
                seed: loss_ms,
                ..SimulationConfig::default()
            };
            simulation.car.motor.coasting_m_s2 = 0.1;
            simulation.car.motor.viscous_per_s = 0.05;
            simulation.car.motor.max_brake_m_s2 = 0.0;
            let options = HostOptions {
                nonce_seed: loss_ms,
                skip_validation: true,
                ..HostOptions::default()
            };
            let mut drive =
                VirtualDrive::with_options(config(period_ms), simulation, options).unwrap();
            let start_us = drive.start().unwrap().now.0 / 1_000 + 2_000_000 + loss_ms * 137;
            drive
                .world
                .cameras
                .parameters
                .loss_windows
                .push(LossWindow {
                    start_us,
                    end_us: start_us + loss_ms * 1_000,
                });
            while drive.next_tick_us() < start_us + 1_500_000 {
                let reason = drive.step().tick.output.reason;
                assert_ne!(
                    reason,
                    Some(Reason::BoardFailsafe),
                    "period {period_ms} ms, lost for {loss_ms} ms"
                );
            }
        }
    }
}

#[test]
fn the_configuration_is_refused_if_the_board_could_be_first() {
    // Each age of a pose is noticed up to a period late.
    for (period_ms, accepted) in [(10, 750), (20, 770), (45, 855)] {
        for (max_pose_age_ms, is_valid) in [(accepted, true), (accepted - 30, false)] {
            let mut config = config(period_ms);
            config.board.max_pose_age_ms = max_pose_age_ms;
            assert_eq!(
                config.validate().is_ok(),
                is_valid,
                "period {period_ms} ms, {max_pose_age_ms} ms: {:?}",
                config.validate()
            );
        }
    }
}
