//! A path that was taught by pushing the simulated car is driven again.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_commissioning::{Place, TeachOptions, taught_path};
use singletrack_control::{Position, direction};
use singletrack_core::config::{Config, PathPoints, ReferenceSection, Start};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{HandMotion, SimulationConfig, StartPose, Truth};

/// Bends by hand: the radius of the rear axle's way (positive to the left), the angle, and the
/// time. Between them the wheels are turned on the spot, so that the path of P has a corner.
const BENDS: [(f64, f64, f64); 4] = [
    (0.9, 1.9, 7.0),
    (-1.4, 1.4, 7.0),
    (-0.8, 2.2, 7.0),
    (1.3, 1.2, 6.0),
];

fn simulation(seed: u64) -> SimulationConfig {
    let mut simulation = SimulationConfig {
        seed,
        ..SimulationConfig::default()
    };
    simulation.car.start = StartPose {
        x_m: -1.0,
        y_m: 0.5,
        yaw_rad: -0.6,
    };
    simulation
}

fn config() -> Config {
    daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: 0.5,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }))
}

fn front_axle(config: &Config, truth: &Truth) -> Position {
    Position::new(truth.x, truth.y) + config.vehicle.front_axle_distance_m * direction(truth.yaw)
}

/// Pushes the car along the bends: the places that the daemon saw, and the true way of the
/// front axle.
fn push(seed: u64) -> (Vec<Place>, Vec<Position>) {
    let config = config();
    let mut drive = VirtualDrive::new(config.clone(), seed, simulation(seed)).unwrap();
    let (mut places, mut way) = (Vec::new(), Vec::new());
    let mut bends = BENDS.into_iter();
    // The board starts up first.
    let mut settled = 0;
    loop {
        let tick = drive.step();
        settled += 1;
        let output = &tick.tick.output;
        if let Some(estimate) = output.estimate.filter(|_| !output.held && settled > 400) {
            places.push(Place {
                position: estimate.position,
                yaw: estimate.yaw,
            });
            way.push(front_axle(&config, &tick.truth));
        }
        let car = drive.world_mut().car_mut();
        if settled > 450 && !car.is_in_motion_by_hand() {
            let Some((radius, angle, for_s)) = bends.next() else {
                break;
            };
            car.begin_by_hand(HandMotion::Turn {
                angle_rad: angle * f64::signum(radius),
                about_m: [-config.vehicle.rear_axle_distance_m, radius],
                wander_m: 0.002,
                for_s,
            });
        }
    }
    (places, way)
}

/// Distance of a position from a way.
fn off(way: &[Position], position: &Position) -> f64 {
    way.iter()
        .map(|at| (at - position).norm())
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn a_path_taught_by_pushing_is_driven_again_within_centimetres() {
    for seed in 0..4 {
        let mut config = config();
        let (places, way) = push(seed);
        let options = TeachOptions {
            front_axle_distance_m: config.law.front_axle_distance_m,
            point_distance_m: config.law.point_distance_m,
            is_closed: false,
            spacing_m: 0.1,
        };
        let taught = taught_path(&places, &options).unwrap();
        config.reference = ReferenceSection::Path {
            points: PathPoints::Points(
                taught
                    .points
                    .iter()
                    .map(|point| [point.x, point.y])
                    .collect(),
            ),
            closed: false,
            speed_m_s: 0.4,
            lateral_acceleration_m_s2: 1.0,
            acceleration_m_s2: 0.5,
            start: Start::Beginning,
        };
        config.validate().unwrap();

        // The board was reset: it takes pushing for a motor that drives by itself.
        let mut drive = VirtualDrive::new(config.clone(), seed + 100, simulation(seed)).unwrap();
        drive.start().unwrap();
        let (mut squares, mut worst, mut count) = (0.0, 0.0_f64, 0.0);
        let mut ended = None;
        for _ in 0..6_000 {
            let tick = drive.step();
            let output = &tick.tick.output;
            if output.mode == Mode::Driving {
                let error = off(&way, &front_axle(&config, &tick.truth));
                squares += error * error;
                worst = worst.max(error);
                count += 1.0;
            } else if output.mode == Mode::Idle || output.mode == Mode::Ready {
                ended = output.reason;
                break;
            }
        }
        let mean = (squares / count).sqrt();
        println!(
            "seed {seed}: {:.2} m taught, smoothed by {:.1} mm; driven {:.1} mm off (root mean \
             square), {:.1} mm at most",
            taught.length_m,
            1e3 * taught.roughness_m,
            1e3 * mean,
            1e3 * worst,
        );
        assert_eq!(ended, Some(Reason::ReferenceFinished), "seed {seed}");
        assert!((4.0..8.0).contains(&taught.length_m), "{}", taught.length_m);
        assert!(mean < 0.015, "seed {seed}: {mean}");
        assert!(worst < 0.04, "seed {seed}: {worst}");
    }
}
