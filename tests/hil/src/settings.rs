//! Configuration of the daemon and the simulation.

use std::{
    net::SocketAddrV4,
    path::{Path, PathBuf},
};

use singletrack_control::VehicleParameters;
use singletrack_core::config::{
    ActuatorsSection, BoardSection, CompensationSection, Config, ControlSection, EstimatorSection,
    FailsafeAction, FenceSection, GovernorSection, LawKind, LawSection, LimitsSection, LiveSection,
    MotionCaptureSection, NeighboursSection, OnlineCalibrationSection, OuterLoopSection,
    PageSection, RecordSection, ReferenceSection, SafetyFilterSection, SerialSection,
    SocketSection, Start, StateSection, SupervisorSection, TuningSection, UpAxis, WatchSection,
};
use singletrack_sim::{SimulationConfig, StartPose, default_board_configuration};

use crate::{Failure, Outcome};

/// The paper's circle with feed-forward, for the simulated car.
///
/// The board's failsafe coasts, so that a stop is always exactly neutral.
pub fn circle(port: &Path, cameras: SocketAddrV4, folder: &Path) -> Config {
    Config {
        serial: SerialSection::new(port),
        motion_capture: MotionCaptureSection {
            command_port: Some(cameras.port()),
            ..MotionCaptureSection::new(*cameras.ip(), "car", UpAxis::Y)
        },
        law: LawSection {
            kind: LawKind::FrontPoint,
            point_distance_m: POINT_DISTANCE_M,
            front_axle_distance_m: VehicleParameters::paper().front_axle_distance_m,
        },
        outer_loop: OuterLoopSection::Proportional {
            gain_per_s: [1.0, 1.0],
            feed_forward: true,
        },
        reference: ReferenceSection::Circle {
            radius_m: RADIUS_M,
            angular_velocity_rad_s: 0.5,
            centre_m: [0.0, 0.0],
            start: Start::Beginning,
        },
        vehicle: VehicleParameters::paper(),
        governor: GovernorSection::default(),
        limits: LimitsSection::default(),
        estimator: EstimatorSection::default(),
        // The bench's car is known to be as configured.
        supervisor: SupervisorSection {
            prove_first_metre: false,
            require_calibration: false,
            ..SupervisorSection::default()
        },
        watch: WatchSection::default(),
        fence: FenceSection::square(FENCE_WIDTH_M, BRAKING_M_S2),
        actuators: ActuatorsSection::default(),
        compensation: CompensationSection::default(),
        safety_filter: SafetyFilterSection::default(),
        neighbours: NeighboursSection::default(),
        tuning: TuningSection::default(),
        online_calibration: OnlineCalibrationSection::default(),
        board: BoardSection {
            failsafe: FailsafeAction::Coast,
            ..BoardSection::from(&default_board_configuration())
        },
        control: ControlSection::default(),
        record: RecordSection {
            min_free_mb: 0,
            enabled: true,
            directory: folder.join("records"),
        },
        state: StateSection {
            directory: folder.join("state"),
        },
        socket: SocketSection {
            enabled: true,
            path: socket(folder),
            tcp_port: None,
            reference_folder: None,
        },
        live: LiveSection::default(),
        page: PageSection::default(),
    }
}

/// Distance of the point P beyond the front axle, in m.
pub const POINT_DISTANCE_M: f64 = 0.35;

/// A lower bound of the simulated car's deceleration at neutral, in m/s².
const BRAKING_M_S2: f64 = 0.9;

/// Width of the geofence around the origin, in m: the circle plus room to turn round, because a
/// car that is armed in the middle of the circle returns to its start.
pub const FENCE_WIDTH_M: f64 = 8.0;

/// Radius of the circle, in m.
pub const RADIUS_M: f64 = 1.0;

/// Initial pose of the car: P at the start of the circle, and the yaw nearly along
/// it.
fn start() -> StartPose {
    const YAW_RAD: f64 = 1.2;
    let reach_m = VehicleParameters::paper().front_axle_distance_m + POINT_DISTANCE_M;
    StartPose {
        x_m: RADIUS_M - reach_m * YAW_RAD.cos(),
        y_m: -reach_m * YAW_RAD.sin(),
        yaw_rad: YAW_RAD,
    }
}

/// Configuration of the simulation.
pub fn simulation(seed: u64) -> SimulationConfig {
    let mut config = SimulationConfig {
        seed,
        ..SimulationConfig::default()
    };
    config.car.start = start();
    config
}

/// Writes a configuration file.
///
/// # Errors
///
/// Fails with an error of the system.
pub fn write(config: &Config, file: &Path) -> Outcome {
    let text = config
        .to_toml()
        .map_err(|error| Failure::new(format!("the configuration: {error}")))?;
    std::fs::write(file, text).map_err(Failure::system("can't write the configuration"))
}

/// The daemon's control socket.
pub fn socket(folder: &Path) -> PathBuf {
    folder.join("control.sock")
}
