//! The watches of a drive: no well calibrated car is stopped by them, whatever the distance of its
//! pulses, and none compares sensors with poses that are too far apart.
//!
//! `cargo run --release --example false_alarms -- --count 10000` drives many more.

use std::collections::BTreeSet;

use singletrack_control::Position;
use singletrack_core::config::{Config, ReferenceSection, Start};
use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::StopCause;
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossWindow, MotorSensorFault, SimulationConfig};

use crate::calibrated::{CalibratedCar, Ended};

const DRIVES: u64 = 36;

/// The circle of the paper: 1.5 m, P at 0.4 m/s.
fn circle(pulse_distance_um: u16) -> Config {
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.5,
        angular_velocity_rad_s: 0.4 / 1.5,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }));
    config.board.speed.pulse_distance_um = pulse_distance_um;
    config
}

fn simulation(pulse_distance_um: u16) -> SimulationConfig {
    let mut simulation = SimulationConfig::default();
    simulation.car.motor_sensor.pulse_distance_um = f64::from(pulse_distance_um);
    simulation
}

fn stop_cause(drive: &VirtualDrive) -> StopCause {
    drive.world.board.code().unwrap().stop_cause()
}

#[test]
fn pulse_distances_from_1_to_30_mm_drive_the_papers_circle() {
    for distance_um in [1_000, 3_000, 6_000, 12_000, 25_000, 30_000] {
        let config = circle(distance_um);
        let mut drive = VirtualDrive::new(config, 1, simulation(distance_um)).unwrap();
        drive.start().unwrap();
        let mut speeds = Vec::new();
        for tick in 0..1_500 {
            let truth = drive.step().truth;
            assert_eq!(
                drive.mode(),
                Mode::Driving,
                "{distance_um} um: {:?} after {tick} ticks",
                stop_cause(&drive)
            );
            if tick >= 500 {
                speeds.push(truth.speed);
            }
        }
        let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
        // The rear axle is a little slower than P.
        assert!((0.36..0.41).contains(&mean), "{distance_um} um: {mean}");
    }
}

#[test]
fn a_dead_sensor_stops_the_car_within_a_quarter_of_a_metre() {
    for distance_um in [1_000, 3_000, 6_000, 12_000, 25_000, 30_000] {
        let config = circle(distance_um);
        let mut drive = VirtualDrive::new(config, 1, simulation(distance_um)).unwrap();
        drive.world.car.sensor_fault = MotorSensorFault::Gone;
        let start = drive.start().unwrap().truth;
        let mut way = 0.0;
        let mut last = Position::new(start.x, start.y);
        for _ in 0..400 {
            let truth = drive.step().truth;
            let now = Position::new(truth.x, truth.y);
            way += (now.x - last.x).hypot(now.y - last.y);
            last = now;
        }
        assert_eq!(stop_cause(&drive), StopCause::MotorSensor);
        assert!(way < 0.25, "{distance_um} um: {way}");
    }
}

/// The markers are seen in one frame of `every`, from this time on, in µs.
fn drive(every: u64, from_us: u64) -> VirtualDrive {
    const FRAME_US: u64 = 10_000;
    let config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: 0.4,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }));
    let mut simulation = SimulationConfig::default();
    simulation.cameras.loss_windows = (0..600)
        .map(|number| {
            let start_us = from_us + number * every * FRAME_US;
            LossWindow {
                start_us,
                end_us: start_us + (every - 1) * FRAME_US,
            }
        })
        .collect();
    VirtualDrive::new(config, 1, simulation).unwrap()
}

#[test]
fn a_car_that_is_seen_in_every_thirteenth_frame_is_not_armed() {
    let mut drive = drive(13, 0);
    assert!(drive.start().is_err());
    let mut reasons = Vec::new();
    for _ in 0..300 {
        reasons.extend(drive.step().tick.output.reason);
    }
    assert!(reasons.contains(&Reason::PosesTooRare), "{reasons:?}");
}

#[test]
fn a_drive_ends_within_1300_ms_when_poses_become_too_rare() {
    const FROM_US: u64 = 8_000_000;
    let mut drive = drive(13, FROM_US);
    drive.start().unwrap();
    while drive.mode() == Mode::Driving {
        drive.step();
        assert!(drive.now_us() < FROM_US + 1_300_000, "it drives on");
    }
    assert!(drive.now_us() > FROM_US + 1_000_000);
    assert_eq!(
        drive.controller().pilot.reason(),
        Some(Reason::PosesTooRare)
    );
}

#[test]
fn a_car_that_is_seen_in_every_tenth_frame_drives_on() {
    const FROM_US: u64 = 8_000_000;
    let mut drive = drive(10, FROM_US);
    drive.start().unwrap();
    while drive.now_us() < FROM_US + 5_000_000 {
        drive.step();
        let reason = drive.controller().pilot.reason();
        assert_eq!(drive.mode(), Mode::Driving, "{reason:?}");
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn random_drives_of_calibrated_cars_have_no_false_alarm() {
        let mut proved = 0;
        let mut kinds = BTreeSet::new();
        for seed in 1..=DRIVES {
            let car = CalibratedCar::random(seed);
            let outcome = car.drive().unwrap();
            assert_eq!(
                outcome.ended,
                Ended::AsRequested,
                "seed {seed} after {:.2} s:\n{}",
                outcome.seconds,
                car.describe()
            );
            proved += u64::from(outcome.proved);
            kinds.extend(car.kinds().iter().cloned());
        }
        // Half of them begin unproved; the slowest need more than the time of the drive.
        assert!(3 * proved >= DRIVES, "{proved} of {DRIVES}");
        for (of, count) in [("reference: ", 6), ("ESC: ", 5), ("failsafe: ", 2)] {
            let drawn = kinds.iter().filter(|kind| kind.starts_with(of));
            assert_eq!(drawn.count(), count, "{kinds:?}");
        }
    }
}
