//! The simulated car, which rolls out rather than brakes, stops inside its fence.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::Position;
use singletrack_core::config::{Config, FenceSection, ReferenceSection, Start, StepSection};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    simulate::{Scenario, simulate},
    simulated::{BRAKING_M_S2, Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossWindow, SimulationConfig};

/// The estimate's error at the side of the fence, in m.
const TOLERANCE: f64 = 0.005;

fn config(reference: ReferenceSection, fence: FenceSection) -> Config {
    let mut config = daemon_config(Drive::following(reference));
    config.fence = fence;
    config
}

/// Room to every side but x.
fn wall(x: f64) -> FenceSection {
    FenceSection {
        corners_m: vec![[-8.0, -8.0], [x, -8.0], [x, 8.0], [-8.0, 8.0]],
        margin_m: Some(0.0),
        ..FenceSection::new(BRAKING_M_S2)
    }
}

/// Drives from the origin until the car stands; the least clearance and why it
/// stopped. The markers are lost for good after this time, in s.
fn drive(config: &Config, seed: u64, blind_after: Option<f64>) -> (f64, Option<Reason>) {
    let simulation = SimulationConfig {
        seed,
        ..SimulationConfig::default()
    };
    let mut drive = VirtualDrive::new(config.clone(), seed, simulation).unwrap();
    drive.start().unwrap();
    if let Some(seconds) = blind_after {
        let start_us = drive.next_tick_us() + (seconds * 1e6) as u64;
        drive.world_mut().cameras_mut().add_loss_window(LossWindow {
            start_us,
            end_us: start_us + 60_000_000,
        });
    }
    let fence = config.fence.fence(&config.vehicle).unwrap();
    let mut least = f64::INFINITY;
    let mut told = None;
    for _ in 0..4_000 {
        let tick = drive.step();
        let truth = tick.truth;
        least = least.min(fence.clearance(&Position::new(truth.x, truth.y)));
        let output = &tick.tick.output;
        if output.mode == Mode::Stopping {
            told = told.or(output.reason);
        }
        if told.is_some() && truth.speed.abs() < 0.01 {
            break;
        }
    }
    (least, told)
}

fn straight(speed: f64) -> ReferenceSection {
    ReferenceSection::VelocitySteps {
        steps: vec![StepSection {
            duration_s: 60.0,
            v_x_m_s: speed,
            v_y_m_s: 0.0,
        }],
    }
}

#[test]
fn straight_at_a_wall_it_stops_in_front_of_it() {
    for speed in [0.3, 0.5, 0.8, 1.0, 1.5] {
        for seed in 0..3 {
            let (least, told) = drive(&config(straight(speed), wall(3.0)), seed, None);
            assert_eq!(told, Some(Reason::OutsideFence), "{speed} m/s");
            // What it looks ahead: its reaction, and the roll as it is configured.
            let looked = 0.1 * speed + 0.5 * speed * speed / BRAKING_M_S2;
            assert!(
                (-TOLERANCE..looked).contains(&least),
                "{speed} m/s: {least:.3} m left"
            );
        }
    }
}

#[test]
fn in_a_bend_it_stops_inside() {
    for speed in [0.5, 0.8, 1.2] {
        for x in [0.6, 0.8] {
            let circle = ReferenceSection::Circle {
                radius_m: 1.0,
                angular_velocity_rad_s: speed,
                centre_m: [0.0, 0.0],
                start: Start::Beginning,
            };
            let (least, told) = drive(&config(circle, wall(x)), 1, None);
            assert_eq!(told, Some(Reason::OutsideFence), "{speed} m/s");
            assert!(least > -TOLERANCE, "{speed} m/s, {x} m: {least:.3} m left");
        }
    }
}

#[test]
fn blind_it_stops_inside_too() {
    for speed in [0.5, 0.8, 1.2] {
        for ahead in [0.1, 0.2, 0.3] {
            let after = 3.0;
            let reached = speed * after - 0.25 * speed * speed;
            let config = config(straight(speed), wall(reached + ahead));
            let (least, _) = drive(&config, 1, Some(after));
            assert!(
                least > -TOLERANCE,
                "{speed} m/s, {ahead} m before the wall: {least:.3} m left"
            );
        }
    }
}

#[test]
fn a_scenario_with_the_safety_filter_keeps_the_centre_of_mass_inside() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../scenarios/safety-filter/through-a-wall.toml"
    );
    let text = std::fs::read_to_string(path).unwrap();
    for speed in ["0.2", "0.4", "0.6"] {
        for seed in 1..=3 {
            let text = text
                .replace("rad_s = 0.4", &format!("rad_s = {speed}"))
                .replace(
                    "duration_s = 30.0",
                    &format!("duration_s = 15.0\nseed = {seed}"),
                );
            let scenario = Scenario::from_toml(&text, path.as_ref()).unwrap();
            let summary = simulate(&scenario).unwrap().summary.unwrap();
            assert!(summary.clearance_min_m >= 0.0, "{speed}: {summary:?}");
            // It stands before the wall, or goes along it.
            assert!(matches!(summary.reason, None | Some("outside-fence")));
        }
    }
}
