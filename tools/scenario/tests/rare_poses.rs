//! Poses that are too far apart to compare the sensors with: no watch of a drive sees anything.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_core::config::{ReferenceSection, Start};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossWindow, SimulationConfig};

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
        drive.controller().pilot().reason(),
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
        let reason = drive.controller().pilot().reason();
        assert_eq!(drive.mode(), Mode::Driving, "{reason:?}");
    }
}
