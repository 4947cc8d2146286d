//! The configuration: one TOML file, units in the key names, unknown keys
//! refused, every value checked before anything starts.
//!
//! `singletrackd.example.toml` lists every key with its default.

mod board;
mod check;
mod control;
mod error;
mod estimator;
mod explain;
mod fence;
mod file;
mod kind;
mod law;
mod limits;
mod motion_capture;
mod outer_loop;
mod output;
mod reference;
mod serial;
mod supervisor;
mod watch;
mod waypoint_file;

use std::path::Path;

use serde::{Deserialize, Serialize};
use singletrack_control::{GRAVITY, VehicleParameters};
use singletrack_link::SessionConfig;
use singletrack_pilot::PilotConfig;

pub use board::{BoardSection, EscSection, FailsafeKind, ServoSection, SpeedSection};
pub use control::ControlSection;
pub use error::ConfigError;
pub use estimator::{EstimatorSection, MarkerLossKind};
pub use fence::FenceSection;
pub use law::{LawKind, LawSection};
pub use limits::LimitsSection;
pub use motion_capture::{
    Bitstream, MotionCaptureSection, PoseSection, TimingSection, TransportKind, UpAxisKind,
};
pub use outer_loop::OuterLoopSection;
pub use output::{LiveSection, RecordSection, SocketSection};
pub use reference::{ReferenceSection, StepSection, WaypointSection};
pub use serial::SerialSection;
pub use supervisor::SupervisorSection;
pub use watch::WatchSection;
pub use waypoint_file::WaypointFileError;

/// From a car that is told to stand to a board that is disarmed, s: the
/// supervisor's rest, a tick, and the request on the line, sent twice.
const REST_S: f64 = 0.15;

/// Everything that the daemon is told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The line to the board.
    pub serial: SerialSection,
    /// The cameras.
    pub motion_capture: MotionCaptureSection,
    /// The linearising law.
    pub law: LawSection,
    /// The position loop around it.
    pub outer_loop: OuterLoopSection,
    /// Where P should be.
    pub reference: ReferenceSection,
    /// The car; the paper's if left out.
    #[serde(default)]
    pub vehicle: VehicleParameters,
    /// What the car may do.
    #[serde(default)]
    pub limits: LimitsSection,
    /// How the state is estimated.
    #[serde(default)]
    pub estimator: EstimatorSection,
    /// When to stop.
    #[serde(default)]
    pub supervisor: SupervisorSection,
    /// What the senses may say, and how punctual a tick must be.
    #[serde(default)]
    pub watch: WatchSection,
    /// Where the car may be.
    #[serde(default)]
    pub fence: FenceSection,
    /// What the board is given.
    pub board: BoardSection,
    /// How the controller runs.
    #[serde(default)]
    pub control: ControlSection,
    /// The record of every tick.
    #[serde(default)]
    pub record: RecordSection,
    /// The control socket.
    #[serde(default)]
    pub socket: SocketSection,
    /// The live view.
    #[serde(default)]
    pub live: LiveSection,
}

impl Config {
    /// Reads and checks a file. Relative paths of waypoints start at its folder.
    ///
    /// # Errors
    ///
    /// What is wrong with it, by key.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = file::read_text(path).map_err(|source| ConfigError::Read {
            path: path.to_owned(),
            source,
        })?;
        let mut config: Self =
            toml::from_str(&text).map_err(|error| ConfigError::parse(Some(path), &text, &error))?;
        if let Some(folder) = path.parent() {
            config.reference.resolve(folder);
        }
        config.validate().map_err(|error| ConfigError::File {
            path: path.to_owned(),
            source: Box::new(error),
        })?;
        Ok(config)
    }

    /// Reads and checks a text. Relative paths start at the working directory.
    ///
    /// # Errors
    ///
    /// What is wrong with it, by key.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let config: Self =
            toml::from_str(text).map_err(|error| ConfigError::parse(None, text, &error))?;
        config.validate()?;
        Ok(config)
    }

    /// The configuration as a file with every key.
    ///
    /// # Errors
    ///
    /// A path that is not UTF-8.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// Refuses what cannot be driven with.
    ///
    /// # Errors
    ///
    /// The first value that is out of range or at odds with another, with key,
    /// value and fix.
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
        self.limits.validate()?;
        self.estimator.validate()?;
        self.supervisor.validate()?;
        self.watch.validate()?;
        self.fence.validate()?;
        self.control.validate()?;
        self.board.configuration().validate()?;
        self.record.validate()?;
        self.socket.validate()?;
        self.validate_together()
    }

    /// Host and board must agree on what the car does.
    fn validate_together(&self) -> Result<(), ConfigError> {
        let Self {
            limits,
            board,
            supervisor,
            control,
            ..
        } = self;
        let fastest = f64::from(board.speed.max_forward_mm_s) / 1_000.0;
        if limits.max_speed_m_s > fastest {
            return Err(ConfigError::value(
                "limits.max_speed_m_s",
                limits.max_speed_m_s,
                format!(
                    "the board obeys at most {fastest} m/s; lower it, or raise board.speed.max_forward_mm_s"
                ),
            ));
        }
        let fastest_reverse = f64::from(board.speed.max_reverse_mm_s) / 1_000.0;
        if limits.max_reverse_speed_m_s > fastest_reverse {
            return Err(ConfigError::value(
                "limits.max_reverse_speed_m_s",
                limits.max_reverse_speed_m_s,
                format!(
                    "the board obeys at most {fastest_reverse} m/s; lower it, or raise board.speed.max_reverse_mm_s"
                ),
            ));
        }
        let servo = &board.servo;
        let room_us = (servo.max_us.saturating_sub(servo.centre_us))
            .min(servo.centre_us.saturating_sub(servo.min_us));
        let reach_rad = f64::from(room_us) / f64::from(servo.gain_us_per_rad).abs();
        if limits.max_steering_rad > reach_rad {
            return Err(ConfigError::value(
                "limits.max_steering_rad",
                limits.max_steering_rad,
                format!(
                    "the servo's pulses reach {reach_rad:.3} rad; lower it, or widen board.servo.min_us and max_us"
                ),
            ));
        }
        if self.motion_capture.pose.max_speed_m_s <= limits.max_speed_m_s {
            return Err(ConfigError::value(
                "motion_capture.pose.max_speed_m_s",
                self.motion_capture.pose.max_speed_m_s,
                format!(
                    "poses of a car at limits.max_speed_m_s, {} m/s, would be refused; raise it",
                    limits.max_speed_m_s
                ),
            ));
        }
        if self.watch.max_gap_ms < 2 * control.period_ms {
            return Err(ConfigError::value(
                "watch.max_gap_ms",
                self.watch.max_gap_ms,
                format!(
                    "every tick would be late: give it two periods, {} ms, or lower control.period_ms",
                    2 * control.period_ms
                ),
            ));
        }
        let ticks_per_s = 1_000 / control.period_ms;
        if self.watch.max_missed_ticks_per_s >= ticks_per_s {
            return Err(ConfigError::value(
                "watch.max_missed_ticks_per_s",
                self.watch.max_missed_ticks_per_s,
                format!(
                    "with control.period_ms = {} there are {ticks_per_s} ticks in a second; lower it",
                    control.period_ms
                ),
            ));
        }
        let grip = self.vehicle.friction * GRAVITY;
        if limits.max_lateral_acceleration_m_s2 > grip {
            return Err(ConfigError::value(
                "limits.max_lateral_acceleration_m_s2",
                limits.max_lateral_acceleration_m_s2,
                format!(
                    "the tyres hold {grip:.2} m/s2 (vehicle.friction times gravity); lower it to that at most"
                ),
            ));
        }
        let blind_ms = 1_000.0
            * (supervisor
                .longest_blind_drive(limits.max_speed_m_s, control.stop_deceleration_m_s2)
                + REST_S);
        if blind_ms > f64::from(board.max_pose_age_ms) {
            return Err(ConfigError::value(
                "board.max_pose_age_ms",
                board.max_pose_age_ms,
                format!(
                    "the host holds a lost pose for supervisor.hold_ms or hold_distance_m, stops from \
                     limits.max_speed_m_s and disarms within {blind_ms:.0} ms, and must be first; raise it \
                     (up to 1000), shorten the hold, lower the speed or brake harder"
                ),
            ));
        }
        Ok(())
    }

    /// For the pilot; reads the waypoints.
    ///
    /// # Errors
    ///
    /// A law or a reference that makes no sense.
    pub fn pilot(&self) -> Result<PilotConfig, ConfigError> {
        Ok(PilotConfig {
            law: self.law.front_point_law(&self.vehicle)?,
            tracking: self.outer_loop.tracking_loop(),
            reference: self.reference.reference()?,
            limits: self.limits.limits(self.vehicle.wheelbase_m()),
            estimator: self.estimator.config(
                &self.vehicle,
                self.motion_capture.marker_offset_m,
                self.motion_capture.marker_yaw_rad,
            ),
            supervisor: self.supervisor.config(),
            watch: self.watch.config(),
            fence: self.fence.fence()?,
            braking: self.fence.braking_m_s2,
            stop_deceleration: self.control.stop_deceleration_m_s2,
            period: check::seconds(self.control.period_ms),
        })
    }

    /// For the session with the board. The seed should differ from one start
    /// to the next.
    #[must_use]
    pub fn link(&self, nonce_seed: u64) -> SessionConfig {
        SessionConfig {
            configuration: self.board.configuration(),
            software_version: software_version(),
            nonce_seed,
            baud: self.serial.baud(),
        }
    }
}

/// The version of this software: major, minor, patch.
fn software_version() -> [u8; 3] {
    [
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
        env!("CARGO_PKG_VERSION_PATCH"),
    ]
    .map(|number| number.parse().unwrap_or(u8::MAX))
}
