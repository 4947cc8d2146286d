//! The configuration: one TOML file, units in the key names, unknown keys
//! refused, every value checked before anything starts.
//!
//! Each section is declared once, with `section!`; the example file
//! `singletrackd.example.toml` and `docs/configuration.md` are generated from that.

mod board;
mod car;
mod cross_checks;
mod error;
mod estimator;
mod fence;
mod loop_model;
mod meta;
mod motion_capture;
mod outer_loop;
mod output;
mod reference;
mod restart_keys;
mod supervisor;
mod tuning;
mod waypoint_file;

use std::path::Path;

use singletrack_control::{SteeringMap, VehicleParameters};
use singletrack_link::SessionConfig;
use singletrack_pilot::{PilotConfig, SupervisorConfig, WatchConfig};
use singletrack_protocol::Configuration;
use singletrack_settings::{Declared as _, Maps as _, seconds, section};

use self::{car::VehicleKeys, outer_loop::OuterLoopKeys, reference::ReferenceKeys};

pub use board::SerialSection;
pub use board::{BoardSection, EscSection, ImuSection, ServoSection, SpeedSection};
pub use car::ActuatorsSection;
pub use car::LimitsSection;
pub use error::ConfigError;
pub use estimator::EstimatorSection;
pub use estimator::{OnlineCalibrationMode, OnlineCalibrationSection};
pub use fence::FenceSection;
pub use fence::GovernorSection;
pub use fence::NeighboursSection;
pub use fence::SafetyFilterSection;
pub use loop_model::{LoopModel, LqiWeights, MpcWeights};
pub use meta::record_meta;
pub(crate) use motion_capture::EXAMPLE_SERVER;
pub use motion_capture::{
    Bitstream, MotionCaptureSection, PoseSection, ServerKind, TimingSection, TransportKind,
};
pub use outer_loop::CompensationSection;
pub use outer_loop::OuterLoopSection;
pub use outer_loop::{LawKind, LawSection};
pub use output::{LiveSection, PageSection, RecordSection, SocketSection, StateSection};
pub use reference::{PathPoints, ReferenceSection, StepSection, WaypointSection};
pub use restart_keys::restart_keys;
pub use singletrack_control::{MarkerLoss, Start};
pub use singletrack_mocap::UpAxis;
pub use singletrack_protocol::{EscKind, FailsafeAction, ImuAxis};
pub use singletrack_settings::{Key, Section};
pub use supervisor::ControlSection;
pub use supervisor::SupervisorSection;
pub use supervisor::WatchSection;
pub use tuning::TuningSection;
pub use tuning::{TuningError, TuningRule};
pub use waypoint_file::WaypointFileError;

section! {
    /// The configuration of the daemon; its parts are in [`SECTIONS`].
    "configuration" => pub Config;
    [new];

    /// The serial line to the board.
    serial: SerialSection;
    /// The cameras.
    motion_capture: MotionCaptureSection;
    /// The linearising law.
    law: LawSection;
    /// The position loop around the law.
    outer_loop: OuterLoopSection;
    /// The reference of P.
    reference: ReferenceSection;
    /// Slows the reference down where the car can't follow it.
    governor: GovernorSection = GovernorSection::default();
    /// The car; the one of the paper if left out.
    vehicle: VehicleParameters = VehicleParameters::default();
    /// What the car may do.
    limits: LimitsSection = LimitsSection::default();
    /// How the state is estimated.
    estimator: EstimatorSection = EstimatorSection::default();
    /// When the car may drive, and when it must stop.
    supervisor: SupervisorSection = SupervisorSection::default();
    /// Plausibility of the sensors, and tick timing.
    watch: WatchSection = WatchSection::default();
    /// Where the car may be.
    fence: FenceSection;
    /// What the board is given.
    board: BoardSection;
    /// How steering and motor are believed to follow their pulses.
    actuators: ActuatorsSection = ActuatorsSection::default();
    /// What the controller corrects of clocks and actuators.
    compensation: CompensationSection = CompensationSection::default();
    /// What keeps the car able to stop inside the geofence, whatever an outer loop asks for.
    safety_filter: SafetyFilterSection = SafetyFilterSection::default();
    /// What keeps the car apart from other rigid bodies.
    neighbours: NeighboursSection = NeighboursSection::default();
    /// What may be changed while the car drives.
    tuning: TuningSection = TuningSection::default();
    /// What a drive says about the calibration.
    online_calibration: OnlineCalibrationSection = OnlineCalibrationSection::default();
    /// How the controller runs.
    control: ControlSection = ControlSection::default();
    /// The record of every tick.
    record: RecordSection = RecordSection::default();
    /// What the daemon remembers.
    state: StateSection = StateSection::default();
    /// The control socket.
    socket: SocketSection = SocketSection::default();
    /// The live view.
    live: LiveSection = LiveSection::default();
    /// The page for a browser.
    page: PageSection = PageSection::default();
}

/// Every section, in the order of the file.
pub const SECTIONS: &[Section] = &[
    SerialSection::SECTION,
    MotionCaptureSection::SECTION,
    PoseSection::SECTION,
    TimingSection::SECTION,
    LawSection::SECTION,
    OuterLoopKeys::SECTION,
    ReferenceKeys::SECTION,
    GovernorSection::SECTION,
    VehicleKeys::SECTION,
    LimitsSection::SECTION,
    EstimatorSection::SECTION,
    SupervisorSection::SECTION,
    WatchSection::SECTION,
    FenceSection::SECTION,
    BoardSection::SECTION,
    ServoSection::SECTION,
    EscSection::SECTION,
    SpeedSection::SECTION,
    ImuSection::SECTION,
    ActuatorsSection::SECTION,
    CompensationSection::SECTION,
    SafetyFilterSection::SECTION,
    NeighboursSection::SECTION,
    TuningSection::SECTION,
    OnlineCalibrationSection::SECTION,
    ControlSection::SECTION,
    RecordSection::SECTION,
    StateSection::SECTION,
    SocketSection::SECTION,
    LiveSection::SECTION,
    PageSection::SECTION,
];

impl Config {
    /// Reads and checks a file. A relative path of waypoints starts at the file's folder.
    ///
    /// # Errors
    ///
    /// The file can't be read, is not valid TOML, or has an invalid key or value.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = waypoint_file::read_text(path).map_err(|source| ConfigError::Read {
            path: path.to_owned(),
            source,
        })?;
        let mut config: Self =
            toml::from_str(&text).map_err(|error| ConfigError::parse(Some(path), &text, &error))?;
        if let Some(folder) = path.parent() {
            config.reference.resolve(folder);
            if let Some(references) = &mut config.socket.reference_folder {
                *references = folder.join(&references);
            }
        }
        config.fence.resolve(&config.vehicle);
        config.validate().map_err(|error| ConfigError::File {
            path: path.to_owned(),
            source: Box::new(error),
        })?;
        Ok(config)
    }

    /// Reads and checks a text. A relative path starts at the working directory.
    ///
    /// # Errors
    ///
    /// The file can't be read, is not valid TOML, or has an invalid key or value.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let mut config: Self =
            toml::from_str(text).map_err(|error| ConfigError::parse(None, text, &error))?;
        config.fence.resolve(&config.vehicle);
        config.validate()?;
        Ok(config)
    }

    /// The configuration as a file with every key.
    ///
    /// # Errors
    ///
    /// A path is not UTF-8.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// The highest `limits.max_speed_m_s` that the configured braking allows, in m/s, rounded down
    /// to cm/s: without a pose, the host holds, stops (`control.stop_deceleration_m_s2`) and disarms
    /// the car within the longest `board.max_pose_age_ms`, a second.
    #[must_use]
    pub fn fastest_stopped_m_s(&self) -> f64 {
        cross_checks::fastest_stopped(self)
    }

    /// Refuses a configuration that can't be driven with.
    ///
    /// # Errors
    ///
    /// The first value that is out of range or contradicts another, with key, value and fix.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.serial.validate()?;
        self.motion_capture.validate()?;
        self.motion_capture.session()?;
        self.vehicle.validate()?;
        if self.law.kind != LawKind::FrontPoint {
            return Err(ConfigError::value(
                "law.kind",
                "velocity-point",
                "the car is driven with \"front-point\" only; the other is for simulations",
            ));
        }
        self.law.validate(&self.vehicle)?;
        self.outer_loop.validate()?;
        self.outer_loop.validate_for(&self.reference.reference()?)?;
        self.governor.check()?;
        self.limits.check()?;
        self.estimator.check()?;
        self.supervisor.check()?;
        self.watch.check()?;
        self.fence.check()?;
        self.fence.fence(&self.vehicle)?;
        self.control.check()?;
        self.board.validate()?;
        self.actuators.check()?;
        self.compensation.check()?;
        self.safety_filter.check()?;
        self.neighbours.check()?;
        self.online_calibration.validate(self)?;
        self.safety_filter.filter(self)?;
        self.record.validate()?;
        self.state.validate()?;
        self.socket.validate()?;
        self.page.validate()?;
        cross_checks::validate(self)?;
        self.pilot().map(drop)?;
        self.tuning.validate(self)
    }

    /// The pilot's configuration; reads the waypoints.
    ///
    /// # Errors
    ///
    /// The law, the loop or the reference is invalid.
    pub fn pilot(&self) -> Result<PilotConfig, ConfigError> {
        let reference = self.reference.reference()?;
        let limits = self
            .limits
            .limits(self.vehicle.wheelbase_m())
            .with_tyres(&self.vehicle);
        let fence = self.fence.fence(&self.vehicle)?;
        let period = seconds(self.control.period_ms);
        let tracking = self.outer_loop.tracking_loop(&LoopModel {
            actuators: (!self.compensation.actuation).then(|| self.actuators.model()),
            limits: &limits,
            fence: Some(&fence),
            reference: &reference,
            period,
        })?;
        let law = self.law.front_point_law(&self.vehicle)?;
        Ok(PilotConfig {
            law,
            tracking,
            reference,
            start: self.reference.start(),
            governor: self.governor.config(self, law, limits)?,
            limits,
            estimator: self.estimator.config(
                &self.vehicle,
                self.motion_capture.marker_offset_m,
                self.motion_capture.marker_yaw_rad,
            ),
            supervisor: SupervisorConfig {
                disarm_age: cross_checks::disarm_age(self),
                ..self.supervisor.config()
            },
            watch: self.watch.apply_to(WatchConfig {
                pulse_distance: f64::from(self.board.speed.pulse_distance_um) * 1e-6,
                height: self.motion_capture.pose.height_m.unwrap_or(ANY_HEIGHT),
                max_capture_uncertainty: self.watch.max_capture_uncertainty_ms / 1_000.0,
                ..WatchConfig::paper()
            }),
            fence,
            braking: self.fence.braking_m_s2,
            stop_deceleration: self.control.stop_deceleration_m_s2,
            compensation: self.compensation.config(&self.actuators, &self.vehicle),
            safety: self.safety_filter.filter(self)?,
            neighbours: self.neighbours.config(self)?,
            tuning: self.tuning.bounds(),
            learns: self.online_calibration.mode == OnlineCalibrationMode::Live,
            period,
        })
    }

    /// The angle of the front wheels over the servo's pulse.
    ///
    /// # Errors
    ///
    /// `actuators.steering_table` is not one of this servo.
    pub fn steering_map(&self) -> Result<SteeringMap, ConfigError> {
        self.actuators.steering_map(&self.board.servo)
    }

    /// What the board is given.
    #[must_use]
    pub fn board_configuration(&self) -> Configuration {
        // A deceleration that was measured with the brake is less at neutral.
        const UNBRAKED: f64 = 2.0;
        const STANDSTILL_S: f64 = 1.0;
        let roll_out_s = UNBRAKED * self.limits.max_speed_m_s / self.fence.braking_m_s2;
        let longest_ms = 1_000.0 * (roll_out_s + STANDSTILL_S);
        Configuration {
            max_roll_out_ms: longest_ms.min(30_000.0) as u16,
            ..self.board.configuration()
        }
    }

    /// The configuration of the session with the board. The seed should differ from one start
    /// to the next.
    #[must_use]
    pub fn link(&self, nonce_seed: u64) -> SessionConfig {
        SessionConfig {
            configuration: self.board_configuration(),
            software_version: software_version(),
            nonce_seed,
            baud: self.serial.baud(),
        }
    }
}

/// The height band of a body whose height is not checked, in m.
const ANY_HEIGHT: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// The version of this software: major, minor, patch.
fn software_version() -> [u8; 3] {
    [
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
        env!("CARGO_PKG_VERSION_PATCH"),
    ]
    .map(|number| number.parse().unwrap_or(u8::MAX))
}
