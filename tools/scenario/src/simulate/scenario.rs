//! Scenario files.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use singletrack_control::{
    FrontPointLaw, LawError, Reference, TrackingLoop, VehicleParameters, VelocityPointLaw,
};
use singletrack_core::config::{
    BoardSection, ConfigError, LawSection, LimitsSection, OuterLoopSection, ReferenceSection,
};

/// A scenario; unknown keys are refused.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// The linearising law.
    pub law: LawSection,
    /// The position loop around it.
    pub outer_loop: OuterLoopSection,
    /// The reference of P.
    pub reference: ReferenceSection,
    /// Where the car starts.
    pub start: StartSection,
    /// How the controller runs.
    pub control: ControlSection,
    /// The plant.
    pub plant: PlantSection,
    /// Duration and seed.
    pub run: RunSection,
    /// When the cameras lose the markers.
    #[serde(default)]
    pub marker_loss: Vec<MarkerLoss>,
    /// The car; the paper's if left out.
    #[serde(default)]
    pub vehicle: VehicleParameters,
    /// The car parameters that the appendix's law uses; it needs mass and stiffnesses. The
    /// true ones if left out.
    #[serde(default)]
    pub believed_vehicle: Option<VehicleParameters>,
    /// The limits of the pilot of plant kind "car"; the daemon's defaults if left out.
    #[serde(default)]
    pub limits: Option<LimitsSection>,
    /// The calibration and the limits of the board of plant kind "car"; those of the
    /// simulated board if left out.
    #[serde(default)]
    pub board: Option<BoardSection>,
}

/// Where the car starts: yaw rate, sideslip and steering are zero.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartSection {
    /// Position of P, placed with the true `l_f`, in m.
    pub point_p_m: [f64; 2],
    /// Yaw, in degrees.
    pub yaw_deg: f64,
}

/// How the controller runs.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSection {
    /// Period of the controller, in ms; 0 for continuous control.
    pub period_ms: u32,
    /// Whether the ticks of plant kind "car" are aligned with the camera frames, as the
    /// daemon's are.
    #[serde(default = "aligns_to_cameras")]
    pub align_to_cameras: bool,
    /// Ticks from measurement to actuation.
    #[serde(default)]
    pub delay_ticks: u32,
    /// How a steering rate becomes steering.
    #[serde(default)]
    pub steering: SteeringHold,
}

const fn aligns_to_cameras() -> bool {
    true
}

/// How a commanded steering rate acts over a period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SteeringHold {
    /// The rate acts through the period.
    #[default]
    Ramp,
    /// Steering jumps by period x rate at the start of the period.
    Step,
}

/// The plant.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantSection {
    /// The kind of plant.
    pub kind: PlantKind,
}

/// The paper's model, or the whole simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// Outer loop and law alone on the paper's equations.
    Ideal,
    /// The whole pilot on the simulated car, board and cameras.
    Car,
}

/// Duration and seed.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSection {
    /// Simulated time, in s.
    pub duration_s: f64,
    /// Seed of all random numbers.
    #[serde(default = "default_seed")]
    pub seed: u64,
}

fn default_seed() -> u64 {
    1
}

/// Ticks without a pose of the cameras.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkerLoss {
    /// The first tick without a pose. At the first tick of the drive, the only pose to
    /// hold is that of the start.
    pub first_tick: u64,
    /// The number of ticks.
    pub ticks: u64,
}

/// An upper bound of the ticks of any simulation.
const MOST_TICKS: u64 = 1_000_000_000;

/// A scenario that can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file can't be read.
    #[error("can't read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a scenario.
    #[error("{}: {message}", .path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// A section of the daemon's configuration is invalid.
    #[error(transparent)]
    Section(#[from] ConfigError),
    /// The law is invalid.
    #[error("[law] {0}")]
    Law(#[from] LawError),
    /// The vehicle is invalid.
    #[error("[vehicle] {0}")]
    Vehicle(#[from] singletrack_control::VehicleParameterError),
    /// A value is outside its range.
    #[error("{key} is {value}: {fix}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// The rule that it breaks.
        fix: &'static str,
    },
}

impl ScenarioError {
    pub(super) fn value(
        key: &'static str,
        value: impl std::fmt::Display,
        fix: &'static str,
    ) -> Self {
        Self::Value {
            key,
            value: format!("{value}"),
            fix,
        }
    }
}

impl Scenario {
    /// Reads and checks a scenario file.
    ///
    /// # Errors
    ///
    /// The scenario is invalid; the error names the key.
    pub fn read(path: &Path) -> Result<Self, ScenarioError> {
        let text = std::fs::read_to_string(path).map_err(|source| ScenarioError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_toml(&text, path)
    }

    /// The scenario with this text. Waypoint files are relative to `path`, which errors
    /// name.
    ///
    /// # Errors
    ///
    /// The scenario is invalid; the error names the key.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, ScenarioError> {
        let mut scenario: Self = toml::from_str(text).map_err(|error| ScenarioError::Parse {
            path: path.to_owned(),
            message: error.to_string(),
        })?;
        if let Some(folder) = path.parent() {
            scenario.reference.resolve(folder);
        }
        scenario.validate()?;
        Ok(scenario)
    }

    /// Refuses values that can't be simulated.
    fn validate(&self) -> Result<(), ScenarioError> {
        self.vehicle.validate()?;
        if let Some(believed) = &self.believed_vehicle {
            believed.validate()?;
        }
        self.law.validate(&self.vehicle)?;
        self.outer_loop.validate()?;
        self.reference()?;
        let [x, y] = self.start.point_p_m;
        if !(x.is_finite() && y.is_finite() && self.start.yaw_deg.is_finite()) {
            return Err(ScenarioError::value(
                "start",
                format!("{x}, {y}, {}", self.start.yaw_deg),
                "position and yaw must be finite",
            ));
        }
        if !(self.run.duration_s.is_finite() && (0.0..=86_400.0).contains(&self.run.duration_s)) {
            return Err(ScenarioError::value(
                "run.duration_s",
                self.run.duration_s,
                "it must lie between 0 and 86400",
            ));
        }
        if self.plant.kind == PlantKind::Ideal {
            for (key, given) in [
                ("limits", self.limits.is_some()),
                ("board", self.board.is_some()),
            ] {
                if given {
                    return Err(ScenarioError::value(
                        key,
                        "given",
                        "plant kind \"ideal\" has neither pilot nor board; remove it, or use \"car\"",
                    ));
                }
            }
        }
        if self.control.period_ms > 1_000 {
            return Err(ScenarioError::value(
                "control.period_ms",
                self.control.period_ms,
                "it must be at most 1000",
            ));
        }
        if self.control.delay_ticks > 1_000 {
            return Err(ScenarioError::value(
                "control.delay_ticks",
                self.control.delay_ticks,
                "it must be at most 1000",
            ));
        }
        if self.control.period_ms == 0 {
            if self.control.delay_ticks > 0 {
                return Err(ScenarioError::value(
                    "control.delay_ticks",
                    self.control.delay_ticks,
                    "continuous control (period_ms = 0) has no ticks to delay; use 0, or a period",
                ));
            }
            if !self.marker_loss.is_empty() {
                return Err(ScenarioError::value(
                    "marker_loss",
                    format!("{} windows", self.marker_loss.len()),
                    "continuous control (period_ms = 0) has no ticks to lose; remove them, or set a period",
                ));
            }
        }
        for (key, ticks) in self.marker_loss.iter().flat_map(|loss| {
            [
                ("marker_loss.first_tick", loss.first_tick),
                ("marker_loss.ticks", loss.ticks),
            ]
        }) {
            if ticks > MOST_TICKS {
                return Err(ScenarioError::value(
                    key,
                    ticks,
                    "it must be at most 1000000000",
                ));
            }
        }
        Ok(())
    }

    pub(crate) fn front_point_law(&self) -> Result<FrontPointLaw, LawError> {
        self.law.front_point_law(&self.vehicle)
    }

    pub(crate) fn velocity_point_law(&self) -> Result<VelocityPointLaw, LawError> {
        let believed = self.believed_vehicle.as_ref().unwrap_or(&self.vehicle);
        self.law.velocity_point_law(believed)
    }

    pub(crate) fn tracking_loop(&self) -> TrackingLoop {
        self.outer_loop.tracking_loop()
    }

    /// The reference, with waypoints read from their file.
    ///
    /// # Errors
    ///
    /// The reference is invalid, or its waypoints can't be read.
    pub fn reference(&self) -> Result<Reference, ConfigError> {
        self.reference.reference()
    }

    pub(crate) fn is_lost(&self, tick: u64) -> bool {
        self.marker_loss
            .iter()
            .any(|loss| tick >= loss.first_tick && tick - loss.first_tick < loss.ticks)
    }
}
