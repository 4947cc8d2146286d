//! Cars whose motor gives a pulse every 1 to 30 mm start and drive; one whose sensor is
//! dead does not get far.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::Position;
use singletrack_core::config::{Config, ReferenceSection, Start};
use singletrack_pilot::Mode;
use singletrack_protocol::StopCause;
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{MotorSensorFault, SimulationConfig};

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
    drive.world().board().code().unwrap().stop_cause()
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
        drive
            .world_mut()
            .car_mut()
            .set_motor_sensor_fault(MotorSensorFault::Gone);
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
