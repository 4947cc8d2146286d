//! A car that has lost its markers is disarmed by the host, before the board must stop it.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_core::{
    HostOptions,
    config::{Config, ReferenceSection, StepSection},
};
use singletrack_pilot::Reason;
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossWindow, SimulationConfig};

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
            drive.world_mut().cameras_mut().add_loss_window(LossWindow {
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
