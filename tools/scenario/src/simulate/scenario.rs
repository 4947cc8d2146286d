//! Scenario files: why one is refused, and how one is laid over another.

use std::path::Path;

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use singletrack_control::{LawError, Limits, Reference, TrackingLoop, VehicleParameters};
use singletrack_core::config::{
    Config, ConfigError, LawSection, LoopModel, OuterLoopSection, ReferenceSection, TuningError,
};
use singletrack_settings::{
    Declared as _, ValueError, Worded, check, explain, explain_table, in_words, section,
};
use singletrack_sim::{BoardKind, CarTruth, SimulationConfig};
use toml::{Table, Value};

use super::{MOMENT, OperatorSection, TuneSection, summary::ROWS_PER_SECOND};
use crate::simulated::{self, daemon_config, follow, merge, start_of};

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
    pub believed_vehicle: Option<VehicleParameters>,
    /// What is true of the car of plant kind "car" and differs from its configuration.
    pub truth: Option<CarTruth>,
    /// Sections of the simulator's file, for plant kind "car": car, board, line, cameras and
    /// server in the simulator's own units.
    pub simulation: Option<Table>,
    /// Who drives plant kind "car".
    pub operator: Option<OperatorSection>,
    /// When the pilot of plant kind "car" is tuned.
    #[serde(default)]
    pub tune: Vec<TuneSection>,
    // Sections of the daemon's configuration, for plant kind "car". A key that is left out
    // is as in the configuration for the simulated car: the daemon's defaults, a fence of the
    // size of a hall, and the calibration of the simulated board.
    /// What slows the reference down.
    pub governor: Option<Table>,
    /// The limits of the pilot.
    pub limits: Option<Table>,
    /// The estimator.
    pub estimator: Option<Table>,
    /// When the pilot drives, and when it stops.
    pub supervisor: Option<Table>,
    /// Plausibility of the sensors, and tick timing.
    pub watch: Option<Table>,
    /// The geofence.
    pub fence: Option<Table>,
    /// The filter between outer loop and law.
    pub safety_filter: Option<Table>,
    /// The calibration and the limits of the board.
    pub board: Option<Table>,
    /// What the host believes of the cameras.
    pub motion_capture: Option<Table>,
    /// How steering and motor are believed to follow.
    pub actuators: Option<Table>,
    /// What the pilot corrects of clocks and actuators.
    pub compensation: Option<Table>,
    /// What may be tuned.
    pub tuning: Option<Table>,
    /// Whether the drive says what is wrong with the calibration.
    pub online_calibration: Option<Table>,
}

section! {
    /// Where the car starts; yaw rate, sideslip and steering are zero.
    "start" => pub StartSection: Copy;
    [];

    /// Position of P, placed with the true distance of the front axle.
    point_p_m: [f64; 2];
    /// Yaw, in degrees.
    yaw_deg: f64;
}

/// How the controller runs.
#[derive(Clone, Debug, Deserialize)]
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
    /// Further keys of the daemon's section, for plant kind "car".
    #[serde(flatten)]
    pub daemon: Table,
}

impl ControlSection {
    /// A controller with this period, in ms, that is as the daemon's.
    pub fn new(period_ms: u32) -> Self {
        Self {
            period_ms,
            align_to_cameras: aligns_to_cameras(),
            delay_ticks: 0,
            steering: SteeringHold::default(),
            daemon: Table::new(),
        }
    }
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

section! {
    /// What is simulated.
    "plant" => pub PlantSection: Copy;
    [];

    /// "ideal": outer loop and law alone on the paper's equations. "car": the whole pilot on the
    /// simulated car, board and cameras.
    kind: PlantKind;
    /// The board of "car": "native", its code; or "uno", the flashed image on a simulated
    /// processor.
    board: BoardKind = BoardKind::default();
}

/// The paper's model, or the whole simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// Outer loop and law alone on the paper's equations.
    Ideal,
    /// The whole pilot on the simulated car, board and cameras.
    Car,
}

section! {
    /// Duration and seed.
    "run" => pub RunSection: Copy;
    [];

    /// Simulated time.
    duration_s: f64, in MOMENT;
    /// Seed of all random numbers.
    seed: u64 = 1;
}

section! {
    /// Ticks without a pose of the cameras, any number of times.
    "marker_loss" => pub MarkerLoss: Copy;
    [];

    /// The first tick without a pose. At the first tick of the drive, the only pose to
    /// hold is that of the start.
    first_tick: u64, in TICKS;
    /// The number of ticks.
    ticks: u64, in TICKS;
    /// Ticks from one beginning of this loss to the next; 0: it comes once.
    repeat_ticks: u64 = 0, in TICKS;
}

impl RunSection {
    /// The index of the last row: the duration need not be a multiple of the interval.
    pub(super) fn last_row(&self) -> u64 {
        (self.duration_s * ROWS_PER_SECOND as f64 + 1e-6) as u64
    }
}

impl MarkerLoss {
    /// The ticks up to `last` at which it begins.
    pub(super) fn beginnings(&self, last: u64) -> impl Iterator<Item = u64> {
        let repeat = self.repeat_ticks;
        let next = move |tick: &u64| tick.checked_add(repeat).filter(|_| repeat > 0);
        let all = std::iter::successors(Some(self.first_tick), next);
        all.take_while(move |tick| *tick <= last)
    }
}

/// An upper bound of the ticks of any simulation.
const TICKS: Worded = in_words("at most 1000000000", |ticks| ticks <= 1e9);

/// The bound of a period, in ms, and of a delay, in ticks.
const AT_MOST_1000: Worded = in_words("at most 1000", |value| value <= 1_000.0);

/// What is done with each section of the daemon's configuration but `[control]`.
macro_rules! daemon_sections {
    ($($section:ident)+) => {
        impl Scenario {
            /// The first of them that is given, or of what else only the car has.
            fn given_section(&self) -> Option<&'static str> {
                let all = [
                    $((stringify!($section), self.$section.is_some()),)+
                    ("truth", self.truth.is_some()),
                    ("simulation", self.simulation.is_some()),
                    ("operator", self.operator.is_some()),
                    ("tune", !self.tune.is_empty()),
                ];
                let mut given = all.into_iter().filter(|(_, is_given)| *is_given);
                given.next().map(|(name, _)| name)
            }

            /// Replaces the keys of the daemon's configuration that are given.
            fn layer_sections(&self, config: &mut Config) -> Result<(), ScenarioError> {
                $(layer(stringify!($section), &mut config.$section, self.$section.as_ref())?;)+
                Ok(())
            }
        }
    };
}

daemon_sections! {
    governor limits board estimator supervisor watch fence safety_filter motion_capture
    actuators compensation tuning online_calibration
}

impl Scenario {
    /// Reads and checks a scenario file.
    ///
    /// # Errors
    ///
    /// The scenario is invalid; the error names the key.
    pub fn read(path: &Path) -> Result<Self, ScenarioError> {
        let text = std::fs::read_to_string(path).map_err(|error| {
            ScenarioError::Text(format!("can't read {}: {error}", path.display()))
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
        let mut scenario: Self = toml::from_str(text).map_err(|error| {
            ScenarioError::Text(format!("{}: {}", path.display(), explain(text, &error)))
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
        let ([x, y], yaw) = (self.start.point_p_m, self.start.yaw_deg);
        let is_finite = x.is_finite() && y.is_finite() && yaw.is_finite();
        let fix = "position and yaw must be finite";
        require(is_finite, "start", format_args!("{x}, {y}, {yaw}"), fix)?;
        self.run.check()?;
        match self.plant.kind {
            PlantKind::Ideal => self.validate_ideal()?,
            PlantKind::Car => {
                let daemon = self.daemon()?;
                self.simulation(&daemon)?;
                let rule = daemon.tuning_rule();
                self.tune.iter().try_for_each(|tune| tune.validate(&rule))?;
                self.operator.unwrap_or_default().check()?;
            }
        }
        let ControlSection {
            period_ms,
            delay_ticks,
            ..
        } = self.control;
        check("control.period_ms", &period_ms, &AT_MOST_1000)?;
        check("control.delay_ticks", &delay_ticks, &AT_MOST_1000)?;
        if period_ms == 0 {
            let key = "control.delay_ticks";
            let fix =
                "continuous control (period_ms = 0) has no ticks to delay; use 0, or a period";
            require(delay_ticks == 0, key, delay_ticks, fix)?;
            let is_in_ticks = matches!(
                self.outer_loop,
                OuterLoopSection::Lqi(_) | OuterLoopSection::Mpc(_) | OuterLoopSection::Own(_)
            );
            let fix = "outer_loop.kind \"lqi\", \"mpc\" and \"own\" have a state that goes on in ticks; set \
                       a period";
            require(!is_in_ticks, "control.period_ms", 0, fix)?;
            let count = self.marker_loss.len();
            let losses = format!("{count} windows");
            let fix = "continuous control (period_ms = 0) has no ticks to lose; remove them, or set a period";
            require(count == 0, "marker_loss", losses, fix)?;
        }
        Ok(self.marker_loss.iter().try_for_each(MarkerLoss::check)?)
    }

    /// Refuses what only the car has.
    fn validate_ideal(&self) -> Result<(), ScenarioError> {
        if let Some(key) = self.given_section() {
            let fix = "plant kind \"ideal\" has neither pilot nor board; remove it, or use \"car\"";
            return Err(ScenarioError::value(key, "given", fix));
        }
        if let Some((key, _)) = self.control.daemon.iter().next() {
            return Err(ScenarioError::Text(format!(
                "[control] unknown field `{key}`: plant kind \"ideal\" takes `period_ms`, \
                 `align_to_cameras`, `delay_ticks` and `steering`"
            )));
        }
        Ok(())
    }

    /// The daemon's configuration, not yet validated: what is believed of the car.
    pub(super) fn daemon(&self) -> Result<Config, ScenarioError> {
        let mut config = daemon_config(simulated::Drive {
            vehicle: self.vehicle,
            law: self.law,
            outer_loop: self.outer_loop.clone(),
            reference: self.reference.clone(),
        });
        config.control.period_ms = self.control.period_ms;
        config.control.align_to_cameras = self.control.align_to_cameras;
        // A car that may differ from its configuration is not known to be as configured.
        config.supervisor.prove_first_metre = self.differs();
        self.layer_sections(&mut config)?;
        let control = Some(&self.control.daemon);
        layer("control", &mut config.control, control)?;
        Ok(config)
    }

    /// Whether the simulated car may differ from its configuration.
    const fn differs(&self) -> bool {
        self.truth.is_some() || self.simulation.is_some()
    }

    /// Refuses keys of the simulator that the scenario has elsewhere.
    fn check_simulation(&self) -> Result<(), ScenarioError> {
        let Some(simulation) = &self.simulation else {
            return Ok(());
        };
        let has = |section: &str, key: &str| {
            let section = simulation.get(section).and_then(Value::as_table);
            section.is_some_and(|section| section.contains_key(key))
        };
        let has_seed = simulation.contains_key("seed");
        let fix = "the seed of a scenario is run.seed; set that one";
        require(!has_seed, "simulation.seed", "given", fix)?;
        let fix = "a scenario starts where [start] says; remove it";
        require(!has("car", "start"), "simulation.car.start", "given", fix)?;
        let fix = "the board of a scenario is plant.board; set that one";
        require(!has("board", "kind"), "simulation.board.kind", "given", fix)
    }

    /// The simulation: what is true of the car. What `[simulation]` and `[truth]` leave out
    /// is as the daemon's configuration says.
    pub(super) fn simulation(&self, believed: &Config) -> Result<SimulationConfig, ScenarioError> {
        let mut simulation = SimulationConfig {
            seed: self.run.seed,
            ..SimulationConfig::default()
        };
        simulation.car.vehicle = self.vehicle;
        simulation.board.kind = self.plant.board;
        follow(believed, &mut simulation);
        self.check_simulation()?;
        layer("simulation", &mut simulation, self.simulation.as_ref())?;
        simulation.validate()?;
        if let Some(truth) = &self.truth {
            truth.apply(&mut simulation)?;
        }
        let yaw = self.start.yaw_deg.to_radians();
        let reach = simulation.car.vehicle.front_axle_distance_m + self.law.point_distance_m;
        simulation.car.start = start_of(self.start.point_p_m, reach, yaw);
        Ok(simulation)
    }

    /// Whether a drive that does not start, or ends, is a result rather than an error.
    pub(super) const fn expects_any_end(&self) -> bool {
        self.differs() || self.operator.is_some()
    }

    /// The loop of plant kind "ideal", whose car has neither lags nor bounds.
    pub(crate) fn tracking_loop(&self) -> Result<TrackingLoop, ConfigError> {
        self.outer_loop.tracking_loop(&LoopModel {
            actuators: None,
            limits: &Limits::paper(),
            fence: None,
            reference: &self.reference()?,
            period: f64::from(self.control.period_ms) / 1_000.0,
        })
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
        self.marker_loss.iter().any(|loss| {
            let since = tick.checked_sub(loss.first_tick);
            since.is_some_and(|since| match loss.repeat_ticks {
                0 => since < loss.ticks,
                repeat => since % repeat < loss.ticks,
            })
        })
    }
}

/// Replaces the keys of a section that are written, at any depth. An unknown key is an
/// error.
fn layer<T: Serialize + DeserializeOwned>(
    section: &'static str,
    base: &mut T,
    written: Option<&Table>,
) -> Result<(), ScenarioError> {
    let Some(written) = written.filter(|written| !written.is_empty()) else {
        return Ok(());
    };
    let error =
        |message: String| ScenarioError::Text(format!("[{section}] {}", message.trim_end()));
    let mut table = Table::try_from(&*base).map_err(|cause| error(cause.to_string()))?;
    merge(&mut table, written);
    *base = table
        .try_into()
        .map_err(|cause| error(explain_table(&cause)))?;
    Ok(())
}

/// Refuses a value that is not good.
pub(super) fn require(
    is_good: bool,
    key: &'static str,
    value: impl std::fmt::Display,
    fix: &'static str,
) -> Result<(), ScenarioError> {
    match is_good {
        true => Ok(()),
        false => Err(ScenarioError::value(key, value, fix)),
    }
}

/// A scenario that can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file can't be read or is no scenario, a section of the daemon's configuration can't be
    /// read, or the daemon refuses a tuning.
    #[error("{0}")]
    Text(String),
    /// A section of the daemon's configuration is invalid.
    #[error(transparent)]
    Section(#[from] ConfigError),
    /// The law is invalid.
    #[error("[law] {0}")]
    Law(#[from] LawError),
    /// The vehicle is invalid.
    #[error("[vehicle] {0}")]
    Vehicle(#[from] singletrack_control::VehicleParameterError),
    /// The truth of the car can't be simulated.
    #[error(transparent)]
    Truth(#[from] singletrack_sim::ConfigError),
    /// A value is outside its range.
    #[error(transparent)]
    Value(#[from] ValueError),
}

impl ScenarioError {
    pub(super) fn value(
        key: &'static str,
        value: impl std::fmt::Display,
        fix: &'static str,
    ) -> Self {
        ValueError::new(key, value, fix).into()
    }

    pub(super) fn tune(at_s: f64, error: &TuningError) -> Self {
        Self::Text(format!("[[tune]] at_s = {at_s}: {error}"))
    }
}
