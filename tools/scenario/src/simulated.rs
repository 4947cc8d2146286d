//! The daemon's configuration for the simulated car.

use std::net::Ipv4Addr;

use singletrack_control::{Position, VehicleParameters, direction};
use singletrack_core::config::{
    BoardSection, Config, FenceSection, LawKind, LawSection, MotionCaptureSection,
    OuterLoopSection, ReferenceSection, SerialSection, UpAxis,
};
use singletrack_sim::{SimulationConfig, StartPose, default_board_configuration};
use toml::{Table, Value};

/// The simulator's name for the car's rigid body.
const RIGID_BODY: &str = "car";

/// Width of the simulated hall, in m.
const HALL_WIDTH_M: f64 = 20.0;

/// A lower bound of the simulated car's deceleration at neutral, in m/s². A roll from v over the
/// way s gives v²/(2 s) = 0.96 from 0.25 m/s, 1.0 from 0.3 m/s and 1.4 from 1 m/s: the car slows
/// down with 0.8 m/s² and 1.0 m/s² for each m/s.
pub const BRAKING_M_S2: f64 = 0.9;

/// The subject of a drive of the simulated car. Everything else has the daemon's
/// defaults.
#[derive(Clone, Debug)]
pub struct Drive {
    /// The car.
    pub vehicle: VehicleParameters,
    /// The linearising law.
    pub law: LawSection,
    /// The position loop around it.
    pub outer_loop: OuterLoopSection,
    /// Where P should be.
    pub reference: ReferenceSection,
}

impl Drive {
    /// The paper's car with P 0.35 m in front of its front axle. P follows the reference with
    /// unit gain and feed-forward; velocity steps, which have no position, are passed on.
    pub fn following(reference: ReferenceSection) -> Self {
        let vehicle = VehicleParameters::paper();
        Self {
            vehicle,
            law: LawSection {
                kind: LawKind::FrontPoint,
                point_distance_m: 0.35,
                front_axle_distance_m: vehicle.front_axle_distance_m,
            },
            outer_loop: match reference {
                ReferenceSection::VelocitySteps { .. } => OuterLoopSection::OpenLoop {},
                _ => OuterLoopSection::Proportional {
                    gain_per_s: [1.0, 1.0],
                    feed_forward: true,
                },
            },
            reference,
        }
    }
}

/// The daemon's configuration for the simulated car, with the calibration of its
/// board. Port, addresses and paths are placeholders: virtual time uses none of them.
pub fn daemon_config(drive: Drive) -> Config {
    let mut config = Config::new(
        SerialSection::new("simulated"),
        MotionCaptureSection::new(Ipv4Addr::LOCALHOST, RIGID_BODY, UpAxis::Y),
        drive.law,
        drive.outer_loop,
        drive.reference,
        // The size of a hall, so that drives may begin and end anywhere.
        FenceSection::square(HALL_WIDTH_M, BRAKING_M_S2),
        BoardSection::from(&default_board_configuration()),
    );
    config.vehicle = drive.vehicle;
    // The simulated car is known to be as configured.
    config.supervisor.prove_first_metre = false;
    config.supervisor.require_calibration = false;
    config
}

/// Where G must be for a point of the car, `reach` (m) ahead of it, to stand at `point` (m).
pub fn start_of([x, y]: [f64; 2], reach: f64, yaw_rad: f64) -> StartPose {
    let centre = Position::new(x, y) - reach * direction(yaw_rad);
    StartPose {
        x_m: centre.x,
        y_m: centre.y,
        yaw_rad,
    }
}

/// Makes the simulated car and its cameras as the daemon's configuration says.
pub fn follow(believed: &Config, simulation: &mut SimulationConfig) {
    simulation.follow(&believed.board.configuration());
    // What is no table is refused with the configuration.
    if let Ok(map) = believed.steering_map() {
        simulation.car.servo.follow(&map);
    }
    let cameras = &believed.motion_capture;
    let body = &mut simulation.cameras.car;
    body.name.clone_from(&cameras.rigid_body);
    if cameras.marker_yaw_rad != 0.0 {
        body.set_yaw(cameras.marker_yaw_rad);
    }
    if cameras.marker_offset_m != [0.0; 2] {
        body.set_pivot(cameras.marker_offset_m);
    }
    simulation.cameras.up_axis = cameras.up_axis;
}

/// Replaces the keys that are written, at any depth.
pub fn merge(base: &mut Table, written: &Table) {
    for (key, value) in written {
        match (base.get_mut(key), value) {
            (Some(Value::Table(base)), Value::Table(written)) => merge(base, written),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}
