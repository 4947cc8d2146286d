//! How far P strays when the cameras lose the markers: the worst of many losses,
//! by speed and by what the supervisor allows. The defaults of `[supervisor]`
//! rest on this table.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example marker_loss
//! ```

#![allow(
    clippy::disallowed_methods,
    reason = "an example prints figures of three digits"
)]

use std::error::Error;

use singletrack_core::{
    HostOptions,
    config::{Config, ReferenceSection, Start},
};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{LossWindow, SimulationConfig, StartPose};

/// Radius of the circle that P is driven on, in m.
const RADIUS: f64 = 1.5;
/// Drives for each line of the table.
const DRIVES: u64 = 24;
/// The first loss, in s after the start: on the circle by then.
const SETTLED: f64 = 8.0;

const SPEEDS: [f64; 3] = [0.4, 0.8, 1.2];
/// How long the markers are lost, in ms; for good at last.
const LOSSES: [u64; 3] = [200, 500, 3_000];

/// What the supervisor allows.
struct Budget {
    name: &'static str,
    set: fn(&mut Config),
}

const BUDGETS: [Budget; 2] = [
    Budget {
        name: "the defaults",
        set: |_| {},
    },
    Budget {
        name: "500 ms, however far",
        set: |config| {
            config.supervisor.hold_ms = 500;
            config.supervisor.hold_distance_m = 1.0;
            config.supervisor.blind_distance_m = 2.0;
        },
    },
];

/// The worst of some drives.
#[derive(Default)]
struct Worst {
    /// From the circle to P, in m.
    off_path: f64,
    /// The way from the loss to standstill, in m; none that stopped, none known.
    way: f64,
    /// Drives that were not ended by the loss.
    survived: u64,
    /// Drives that the board had to end.
    by_board: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "{:<20} {:>9} {:>9} {:>14} {:>14} {:>9} {:>9}",
        "budget", "speed m/s", "loss ms", "P off path mm", "travel to stop", "drove on", "by board"
    );
    for budget in BUDGETS {
        for speed in SPEEDS {
            for loss_ms in LOSSES {
                let mut worst = Worst::default();
                for drive in 0..DRIVES {
                    lose(&budget, speed, loss_ms, drive, &mut worst)?;
                }
                println!(
                    "{:<20} {speed:>9} {loss_ms:>9} {:>14.0} {:>14.2} {:>6}/{DRIVES} {:>6}/{DRIVES}",
                    budget.name,
                    worst.off_path * 1e3,
                    worst.way,
                    worst.survived,
                    worst.by_board
                );
            }
        }
    }
    Ok(())
}

fn config(budget: &Budget, speed: f64) -> Config {
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: RADIUS,
        angular_velocity_rad_s: speed / RADIUS,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }));
    (budget.set)(&mut config);
    config
}

/// Drives, loses the markers once, and takes down the worst.
fn lose(
    budget: &Budget,
    speed: f64,
    loss_ms: u64,
    number: u64,
    worst: &mut Worst,
) -> Result<(), Box<dyn Error>> {
    let config = config(budget, speed);
    let mut simulation = SimulationConfig {
        seed: number,
        ..SimulationConfig::default()
    };
    let vehicle = simulation.car.vehicle;
    let point_distance = config.law.point_distance_m;
    // P where the circle begins, nearly along it.
    let yaw_rad = 1.3_f64;
    let reach = vehicle.front_axle_distance_m + point_distance;
    simulation.car.start = StartPose {
        x_m: RADIUS - reach * yaw_rad.cos(),
        y_m: -reach * yaw_rad.sin(),
        yaw_rad,
    };
    // The second budget is one that the daemon refuses.
    let options = HostOptions {
        nonce_seed: number,
        skip_validation: true,
        ..HostOptions::default()
    };
    let mut drive = VirtualDrive::with_options(config, simulation, options)?;
    drive.start()?;
    // Over the whole of the circle and of a tick.
    let start_us = drive.next_tick_us() + (SETTLED * 1e6) as u64 + number * 413_700;
    let end_us = start_us + loss_ms * 1_000;
    drive
        .world
        .cameras
        .parameters
        .loss_windows
        .push(LossWindow { start_us, end_us });

    let mut last: Option<[f64; 2]> = None;
    let mut way = 0.0;
    loop {
        let now_us = drive.next_tick_us();
        let tick = drive.step();
        if now_us < start_us {
            continue;
        }
        let truth = tick.truth;
        let [x, y] = truth.point_p(vehicle.front_axle_distance_m, point_distance);
        worst.off_path = worst.off_path.max((x.hypot(y) - RADIUS).abs());
        if let Some([x, y]) = last {
            way += (truth.x - x).hypot(truth.y - y);
        }
        last = Some([truth.x, truth.y]);
        let output = &tick.tick.output;
        if !output.mode.commands() {
            worst.by_board += u64::from(output.reason == Some(Reason::BoardFailsafe));
            if truth.speed.abs() < 0.01 {
                worst.way = worst.way.max(way);
                return Ok(());
            }
        } else if now_us > end_us + 1_000_000 && output.mode == Mode::Driving {
            worst.survived += 1;
            return Ok(());
        }
    }
}
