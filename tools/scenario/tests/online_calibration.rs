//! What a drive says about a calibration that is wrong.

use std::path::Path;

use singletrack_control::CalibrationParameter as Parameter;
use singletrack_core::{
    Config,
    config::OnlineCalibrationMode,
    online_calibration::{OnlineCalibration, corrected, corrections},
};
use singletrack_pilot::{Event, Learned, Mode, Output};
use singletrack_record::{Entry, Replay};
use singletrack_scenario::{
    simulate::{RunOptions, Scenario, Simulation, simulate_configured, virtual_drive_config},
    virtual_drive::VirtualDrive,
};

const EIGHT: &str = include_str!("../../scenarios/best/eight-6x3.toml");
const CIRCLE: &str = include_str!("../../scenarios/best/circle-1.5.toml");

/// Advice on the drive of a file, with this seed and this truth.
fn scenario(file: &str, seed: u64, truth: &str) -> Scenario {
    // The first metre is driven as by a car that is known, so that the drives compare.
    let text = format!(
        "{file}seed = {seed}\n{truth}\n[online_calibration]\nmode = \"advice\"\n[supervisor]\n\
         prove_first_metre = false\n"
    );
    Scenario::from_toml(&text, Path::new("scenario.toml")).unwrap()
}

fn drive(scenario: &Scenario) -> Simulation {
    let (daemon, simulation) = virtual_drive_config(scenario).unwrap();
    simulate_configured(scenario, &daemon, &simulation, RunOptions::default()).unwrap()
}

fn rms_mm(simulation: &Simulation) -> f64 {
    1e3 * simulation.summary.as_ref().unwrap().tracking_rms_m.unwrap()
}

/// Drives with an error, finds it alone, and drives again with the correction: P is as close to
/// its reference as with a calibrated car.
fn finds_and_corrects(truth: &str, parameter: Parameter, deviation: f64) {
    let scenario = scenario(EIGHT, 1, truth);
    let (daemon, car) = virtual_drive_config(&scenario).unwrap();
    let options = RunOptions::default();
    let before = simulate_configured(&scenario, &daemon, &car, options).unwrap();
    for estimate in &before.estimates {
        let is_wrong = estimate.parameter == parameter;
        assert!(estimate.observable, "{estimate:?}");
        assert_eq!(estimate.is_off(), is_wrong, "{estimate:?}");
        let truth = if is_wrong { deviation } else { 0.0 };
        let error = (estimate.value - truth).abs();
        assert!(error <= estimate.half_width, "{estimate:?}");
    }
    let corrections = corrections(&daemon, &before.estimates);
    if parameter == Parameter::GyroScale {
        // It has no key: the estimator follows it.
        assert!(corrections.is_empty());
        return;
    }
    let daemon = corrected(&daemon, &corrections).unwrap();
    let after = simulate_configured(&scenario, &daemon, &car, options).unwrap();
    let [before, after] = [before, after].map(|simulation| rms_mm(&simulation));
    println!("{parameter}: {before:.2} mm, then {after:.2} mm");
    assert!(before > 8.0 || parameter == Parameter::PulseDistance);
    // A stamp is found to some 2 ms, at 1 m/s.
    let bound = if parameter == Parameter::StampOffset {
        6.0
    } else {
        4.0
    };
    assert!(after < bound, "{before} mm, then {after} mm");
}

#[test]
fn a_wrong_steering_gain_is_found() {
    let truth = "[truth.servo]\ngain_us_per_rad = -1000.0";
    finds_and_corrects(truth, Parameter::SteeringGain, -0.2);
}

#[test]
fn a_lag_of_the_servo_is_not_taken_for_late_stamps() {
    let slow = drive(&scenario(EIGHT, 1, "[truth.servo]\nlag_ms = 60.0"));
    assert!(slow.estimates.iter().all(|estimate| !estimate.is_off()));
}

#[test]
fn nothing_is_observable_on_a_steady_circle() {
    for seed in 1..=3 {
        for estimate in drive(&scenario(CIRCLE, seed, "")).estimates {
            assert!(!estimate.observable, "{estimate:?}");
        }
    }
}

#[test]
fn estimates_change_no_bit_of_a_drive_and_are_off_by_default() {
    let advised = scenario(EIGHT, 1, "");
    let mut plain = advised.clone();
    plain.online_calibration = None;
    let [advised, plain] = [advised, plain].map(|mut scenario| {
        scenario.run.duration_s = 5.0;
        drive(&scenario)
    });
    assert!(plain.estimates.is_empty());
    assert_eq!(advised.estimates.len(), Parameter::ALL.len());
    // Nothing is known yet.
    assert!(
        advised
            .estimates
            .iter()
            .all(|estimate| !estimate.observable)
    );
    assert!(advised.rows == plain.rows);
}

/// A drive that learns, step by step.
struct LiveDrive {
    drive: VirtualDrive,
    calibration: OnlineCalibration,
    last: Output,
}

impl LiveDrive {
    fn begin(truth: &str) -> (Config, Self) {
        let (mut config, car) = virtual_drive_config(&scenario(EIGHT, 1, truth)).unwrap();
        config.online_calibration.mode = OnlineCalibrationMode::Live;
        let mut drive = VirtualDrive::new(config.clone(), 1, car).unwrap();
        drive.keep_entries();
        let calibration = OnlineCalibration::new(&config).unwrap();
        let first = drive.start().unwrap();
        let now_us = drive.now_us();
        drive.world.set_epoch(Some(now_us));
        let last = first.tick.output;
        let live = Self {
            drive,
            calibration,
            last,
        };
        (config, live)
    }

    /// Goes on for this time (s), or until the drive ends.
    fn drive_on(&mut self, time: f64) {
        let end_us = self.drive.now_us() + (time * 1e6) as u64;
        while self.drive.now_us() < end_us && self.last.mode == Mode::Driving {
            let tick = self.drive.step().tick;
            if let Some(learned) = self.calibration.tick(&tick) {
                self.drive.learned(learned).unwrap();
            }
            self.last = tick.output;
        }
    }

    fn learned(&self) -> Learned {
        self.drive.controller().pilot.learned().unwrap()
    }
}

#[test]
fn a_live_drive_learns_what_is_wrong_and_is_replayed_to_the_bit() {
    let truth = "[truth.servo]\ngain_us_per_rad = -1000.0\n[truth.cameras]\nbody_yaw_deg = 1.0";
    let (config, mut live) = LiveDrive::begin(truth);
    live.drive_on(30.0);
    // Nothing is known yet.
    assert_eq!(live.learned(), Learned::default());
    live.drive_on(60.0);
    assert_eq!(live.last.mode, Mode::Driving, "{:?}", live.last.reason);
    let learned = live.learned();
    assert!((learned.steering_gain + 0.2).abs() < 0.01, "{learned:?}");
    let yaw = 1_f64.to_radians();
    assert!((learned.body_yaw - yaw).abs() < 0.001, "{learned:?}");
    let rest = Learned {
        steering_gain: 0.0,
        body_yaw: 0.0,
        ..learned
    };
    assert_eq!(rest, Learned::default());
    // P is where it should be, and the judges see the configured car.
    let away = |output: &Output| {
        (output.point.unwrap() - output.reference.unwrap().position.unwrap()).norm()
    };
    assert!(away(&live.last) < 0.012, "{}", away(&live.last));
    let believed = (live.last.actuation.steering, live.last.command.unwrap());
    let sent = learned.command(believed.0);
    assert!((believed.1.steering - sent).abs() < 1e-6, "{believed:?}");

    let mut replay = Replay::new(config.pilot().unwrap());
    let mut told = 0;
    for entry in live.drive.entries() {
        let Entry::Tick(tick) = entry else { continue };
        let is_told = |event: &&Event| matches!(event, Event::Learned(_));
        told += tick.events.iter().filter(is_told).count();
        let output = replay.tick(&tick).unwrap();
        assert!(tick.is_output(&output), "{:?}", tick.differences(&output));
    }
    assert!(told > 50, "{told}");
}

#[test]
fn a_live_drive_of_a_calibrated_car_is_the_drive_without_to_the_bit() {
    let scenario = scenario(EIGHT, 1, "");
    let (plain, car) = virtual_drive_config(&scenario).unwrap();
    let mut live = plain.clone();
    live.online_calibration.mode = OnlineCalibrationMode::Live;
    let drive = |config| {
        simulate_configured(&scenario, config, &car, RunOptions::default())
            .unwrap()
            .rows
    };
    assert!(drive(&live) == drive(&plain));
}

#[test]
fn a_horn_that_slips_is_told_from_slow_learning() {
    let truth = "[truth.servo]\nslips_at_s = 80.0\nslip_deg = 2.865\ncentre_us = 1525";
    let (_, mut live) = LiveDrive::begin(truth);
    live.drive_on(80.0);
    let before = live.learned();
    assert!(
        (before.steering_trim - 25.0 / 800.0).abs() < 0.002,
        "{before:?}"
    );
    assert_eq!(live.calibration.errors.steering_change, None);
    live.drive_on(20.0);
    let change = live.calibration.errors.steering_change.unwrap();
    assert!((change - 0.05).abs() < 0.015, "{change}");
    let frozen = live.learned();
    assert!(
        (frozen.steering_trim - before.steering_trim).abs() < 0.003,
        "{frozen:?}"
    );
    // Nothing more is learned, and the car drives on.
    live.drive_on(60.0);
    assert_eq!(live.learned(), frozen);
    assert_eq!(live.last.mode, Mode::Driving);
}

#[test]
fn a_stuck_servo_ends_the_drive_and_teaches_nothing() {
    let truth = "[truth.servo]\nstuck_from_s = 80.0\ngain_us_per_rad = -1000.0";
    let (_, mut live) = LiveDrive::begin(truth);
    live.drive_on(80.0);
    let before = live.learned();
    assert!(before.steering_gain < -0.19, "{before:?}");
    live.drive_on(20.0);
    assert_ne!(live.last.mode, Mode::Driving);
    let after = live.learned();
    let change = (after.steering_gain - before.steering_gain).abs();
    assert!(change < 0.005, "{before:?} {after:?}");
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_wrong_trim_is_found() {
        let truth = "[truth.servo]\ncentre_us = 1541.9";
        finds_and_corrects(truth, Parameter::SteeringTrim, 41.9 / 800.0);
    }

    #[test]
    fn late_stamps_are_found() {
        let truth = "[truth.cameras]\nstamp_bias_ms = 20.0";
        finds_and_corrects(truth, Parameter::StampOffset, 0.02);
    }

    #[test]
    fn a_turned_body_is_found() {
        let truth = "[truth.cameras]\nbody_yaw_deg = 1.0";
        finds_and_corrects(truth, Parameter::BodyYaw, 1.0_f64.to_radians());
    }

    #[test]
    fn a_pivot_elsewhere_is_found() {
        let forward = "[truth.cameras]\npivot_m = [0.01, 0.0]";
        finds_and_corrects(forward, Parameter::PivotForward, 0.01);
        let left = "[truth.cameras]\npivot_m = [0.0, 0.01]";
        finds_and_corrects(left, Parameter::PivotLeft, 0.01);
    }

    #[test]
    fn the_scale_of_gyro_and_pulses_is_found() {
        let gyro = "[truth.imu]\ngyro_scale = 1.03";
        finds_and_corrects(gyro, Parameter::GyroScale, 0.03);
        let pulses = "[truth.motor_sensor]\npulse_distance_um = 3090.0";
        finds_and_corrects(pulses, Parameter::PulseDistance, 0.03);
    }

    #[test]
    fn a_calibrated_car_gets_no_advice() {
        for seed in 101..=106 {
            let simulation = drive(&scenario(EIGHT, seed, ""));
            for estimate in simulation.estimates {
                assert!(estimate.observable && !estimate.is_off(), "{estimate:?}");
            }
        }
    }
}
