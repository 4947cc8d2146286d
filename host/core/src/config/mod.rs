//! The configuration: one TOML file, units in the key names, unknown keys
//! refused, every value checked before anything starts.
//!
//! Each section is declared once, with `section!`; the example file
//! `singletrackd.example.toml` and `docs/configuration.md` are generated from that.

mod board;
mod car;
mod cross_checks;
mod fence;
mod motion_capture;
mod outer_loop;
mod output;
mod reference;
mod supervisor;
mod tuning;

use core::fmt;
use std::{collections::BTreeMap, path::Path};

use singletrack_control::{
    LawError, ReferenceError, SteeringMap, VehicleParameterError, VehicleParameters,
};
use singletrack_link::SessionConfig;
use singletrack_pilot::{FenceError, PilotConfig, SupervisorConfig, WatchConfig};
use singletrack_protocol::{Configuration, ConfigurationError, ConfigurationField};
use singletrack_record::{ClockMapping, Meta};
use singletrack_settings::{Declared as _, Maps as _, ValueError, explain, seconds, section};
use toml::Value;

use self::{car::VehicleKeys, outer_loop::OuterLoopKeys, reference::ReferenceKeys};

pub use board::{BoardSection, EscSection, ImuSection, SerialSection, ServoSection, SpeedSection};
pub(crate) use car::scaled_paper;
pub use car::{
    ActuatorsSection, EstimatorSection, LimitsSection, OnlineCalibrationMode,
    OnlineCalibrationSection,
};
pub use fence::{FenceSection, GovernorSection, NeighboursSection, SafetyFilterSection};
pub(crate) use motion_capture::EXAMPLE_SERVER;
pub use motion_capture::{
    Bitstream, MotionCaptureSection, PoseSection, ServerKind, TimingSection, TransportKind,
};
pub use outer_loop::{
    CompensationSection, LawKind, LawSection, LoopModel, LqiWeights, MpcWeights, OuterLoopSection,
    OwnLoop, OwnLoopKind, OwnLoopSection, link_own_loops, own_loops,
};
pub use output::{LiveSection, PageSection, RecordSection, SocketSection, StateSection};
pub use reference::{PathPoints, ReferenceSection, StepSection, WaypointSection};
pub use singletrack_control::{MarkerLoss, Start};
pub use singletrack_mocap::UpAxis;
pub use singletrack_protocol::{EscKind, FailsafeAction, ImuAxis};
pub use singletrack_settings::{Key, Section};
pub use supervisor::{ControlSection, SupervisorSection, WatchSection};
pub use tuning::{TuningError, TuningRule, TuningSection};

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
    vehicle: VehicleParameters = VehicleParameters::default(), from VehicleKeys;
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
        let shown = path.display();
        let text = reference::read_text(path)
            .map_err(|error| ConfigError::Text(format!("can't read {shown}: {error}")))?;
        Self::parse(&text, path.parent())
            .map_err(|error| ConfigError::Text(format!("{shown}: {error}")))
    }

    /// Reads and checks a text. A relative path starts at the working directory.
    ///
    /// # Errors
    ///
    /// The file can't be read, is not valid TOML, or has an invalid key or value.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        Self::parse(text, None)
    }

    /// Reads and checks a text whose relative paths start at this folder.
    fn parse(text: &str, folder: Option<&Path>) -> Result<Self, ConfigError> {
        let mut config: Self =
            toml::from_str(text).map_err(|error| ConfigError::Text(explain(text, &error)))?;
        if let Some(folder) = folder {
            config.reference.resolve(folder);
            if let Some(references) = &mut config.socket.reference_folder {
                *references = folder.join(&references);
            }
            if let Some(certificate) = &mut config.safety_filter.certificate {
                *certificate = folder.join(&certificate);
            }
        }
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
        let is_other = self.law.kind != LawKind::FrontPoint;
        let fix = "the car is driven with \"front-point\" only; the other is for simulations";
        refuse_if(is_other, "law.kind", "velocity-point", fix)?;
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
        let limits = self.limits.limits(self.vehicle.wheelbase_m());
        let limits = limits.with_tyres(&self.vehicle);
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
                &self.actuators.model(),
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

/// Why a configuration is refused: key, value and fix.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file can't be read, its text does not parse (a syntax error, an unknown or a missing key,
    /// a value of the wrong type), or it is refused: which, where and why.
    #[error("{0}")]
    Text(String),
    /// The reference is invalid.
    #[error("reference.{0}")]
    Reference(#[from] ReferenceError),
    /// The fence is not a simple polygon.
    #[error("fence.corners_m: {0}")]
    Fence(#[from] FenceError),
    /// The law is invalid for the vehicle.
    #[error("law.{0}")]
    Law(#[from] LawError),
    /// A vehicle parameter is invalid.
    #[error("vehicle.{} is {}: it must be finite and above zero", .0.name, .0.value)]
    Vehicle(#[from] VehicleParameterError),
    /// The board refuses a value.
    #[error("{}", board_message(.0))]
    Board(#[from] ConfigurationError),
    /// A value is outside its range, or contradicts another.
    #[error(transparent)]
    Value(#[from] ValueError),
}

impl ConfigError {
    pub(crate) fn value(
        key: &'static str,
        value: impl fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        ValueError::new(key, value, fix).into()
    }
}

/// Refuses the value of a key if it is wrong.
pub(crate) fn refuse_if(
    is_wrong: bool,
    key: &'static str,
    value: impl fmt::Display,
    fix: impl Into<String>,
) -> Result<(), ConfigError> {
    match is_wrong {
        true => Err(ConfigError::value(key, value, fix)),
        false => Ok(()),
    }
}

/// Top speed of the finest pulses that do not limit it.
const TOP_SPEED_MM_S: u16 = 20_000;

fn board_message(error: &ConfigurationError) -> String {
    if error.field == ConfigurationField::ServoGainMagnitude {
        return format!(
            "board.servo.gain_us_per_rad has the magnitude {}, but must have {} to {}",
            error.value, error.lowest, error.highest
        );
    }
    let coarse = match error.field {
        ConfigurationField::MaxForward | ConfigurationField::MaxReverse
            if (1..i32::from(TOP_SPEED_MM_S)).contains(&error.highest) =>
        {
            ": the board measures no more than 12 pulses of board.speed.pulse_distance_um in a \
             millisecond; use a sensor with fewer edges per turn or a lower speed"
        }
        _ => "",
    };
    format!("board.{error}{coarse}")
}

/// The name of this software in the metadata.
const SOFTWARE: &str = "singletrackd";

/// The name of the controller in the metadata, with its number.
const CONTROLLER: &str = "controller";

/// The metadata of a record with this configuration, seed and clock mapping, for this
/// version of the software.
///
/// # Errors
///
/// The configuration has a path that is not UTF-8.
pub fn record_meta(
    config: &Config,
    seed: Option<u64>,
    start: ClockMapping,
) -> Result<Meta, toml::ser::Error> {
    Ok(Meta {
        configuration: config.to_toml()?,
        software: BTreeMap::from([
            (SOFTWARE.to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            (
                CONTROLLER.to_owned(),
                singletrack_pilot::CONTROLLER.to_string(),
            ),
        ]),
        protocol_version: singletrack_protocol::VERSION,
        seed,
        start,
    })
}

/// The keys in which `new` differs from `old` and that require a restart: first those of
/// sections that require a restart as a whole.
///
/// # Errors
///
/// A path is not UTF-8. No configuration file can contain one.
pub fn restart_keys(old: &Config, new: &Config) -> Result<Vec<String>, toml::ser::Error> {
    let (old, new) = (Value::try_from(old)?, Value::try_from(new)?);
    let (whole, partly): (Vec<&Section>, Vec<_>) =
        SECTIONS.iter().partition(|section| section.restart);
    let mut keys = Vec::new();
    for section in whole.into_iter().chain(partly) {
        for key in section.keys {
            let path = format!("{}.{}", section.name, key.name);
            // A section within this one is in the list itself.
            let is_section = SECTIONS.iter().any(|section| section.name == path);
            let takes_restart = section.restart || key.restart;
            if takes_restart && !is_section && value_at(&old, &path) != value_at(&new, &path) {
                keys.push(path);
            }
        }
    }
    Ok(keys)
}

/// The value at a path such as `motion_capture.pose.max_speed_m_s`.
pub(crate) fn value_at<'a>(config: &'a Value, path: &str) -> Option<&'a Value> {
    path.split('.')
        .try_fold(config, |value, name| value.get(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_a_restart_is_named_and_nothing_else_is() {
        let old =
            Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap();
        assert_eq!(restart_keys(&old, &old).unwrap(), [""; 0]);

        let mut new = old.clone();
        new.limits.max_speed_m_s = 1.0;
        new.control.stop_deceleration_m_s2 = 2.5;
        new.supervisor.hold_ms = 200;
        new.motion_capture.marker_yaw_rad = 0.1;
        new.motion_capture.timing.stamp_offset_ms = 2.0;
        assert_eq!(restart_keys(&old, &new).unwrap(), [""; 0]);

        new.serial.port = "/dev/ttyACM1".into();
        new.motion_capture.pose.max_speed_m_s = 6.0;
        new.control.period_ms = 20;
        new.socket.enabled = false;
        assert_eq!(
            restart_keys(&old, &new).unwrap(),
            [
                "serial.port",
                "socket.enabled",
                "motion_capture.pose.max_speed_m_s",
                "control.period_ms"
            ]
        );
    }
}
