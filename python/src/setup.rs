//! Arguments from Python, the errors that name them, and the configuration of a simulated car from
//! what Python gives.

use std::time::Duration;

use pyo3::{
    PyErr, PyResult,
    exceptions::{PyRuntimeError, PyValueError},
};
use singletrack_core::config::{Config, ReferenceSection};
use singletrack_scenario::{
    simulate::merge,
    simulated::{Drive, daemon_config, follow, start_of},
};
use singletrack_sim::{CarTruth, SimulationConfig, StartPose};
use toml::{Table, Value};

/// An argument is wrong.
pub(crate) fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A call can't be obeyed now.
pub(crate) fn fail(error: impl ToString) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

/// A time in s, which may not be negative.
pub(crate) fn seconds(time: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(time).map_err(refuse)
}

/// The value of a word; another word is refused with those that are known.
pub(crate) fn choice<T: Copy>(name: &str, word: &str, known: &[(&str, T)]) -> PyResult<T> {
    let found = known.iter().find(|(known, _)| *known == word);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<String> = known.iter().map(|(word, _)| format!("{word:?}")).collect();
        refuse(format!("{name} is {word:?}: use {}", words.join(" or ")))
    })
}

/// Why a simulation can't be set up; the text names the key.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct SetupError(String);

impl SetupError {
    pub(crate) fn new(text: impl ToString) -> Self {
        Self(text.to_string().trim_end().to_owned())
    }
}

/// A named number of the table `[truth]`, such as `servo.lag_ms`.
#[derive(Clone, Debug)]
pub(crate) struct TruthRange {
    pub(crate) section: String,
    pub(crate) key: String,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// What is believed and what is true of a simulated car.
#[derive(Clone, Debug)]
pub(crate) struct Setup {
    pub(crate) config: Config,
    pub(crate) simulation: SimulationConfig,
    truth: Table,
}

impl Setup {
    /// `configuration` holds keys of the daemon's configuration that differ from those of
    /// the simulated car, `truth` what is true of the car and differs from the configuration.
    pub(crate) fn new(
        reference: ReferenceSection,
        configuration: &str,
        truth: &str,
    ) -> Result<Self, SetupError> {
        let mut config = daemon_config(Drive::following(reference));
        let written: Table = parse("configuration", configuration)?;
        if !written.is_empty() {
            let own = config.to_toml().map_err(SetupError::new)?;
            let mut table: Table = parse("configuration", &own)?;
            // The keys of a reference depend on its kind.
            if written.contains_key("reference") {
                table.insert("reference".to_owned(), Value::Table(Table::new()));
            }
            merge(&mut table, &written);
            let text = toml::to_string(&table).map_err(SetupError::new)?;
            config = Config::from_toml(&text).map_err(SetupError::new)?;
        }
        let mut simulation = SimulationConfig::default();
        simulation.car.vehicle = config.vehicle;
        follow(&config, &mut simulation);
        Ok(Self {
            config,
            simulation,
            truth: parse("truth", truth)?,
        })
    }

    /// The simulation of one car of this kind.
    pub(crate) fn simulation(
        &self,
        seed: u64,
        start: StartPose,
        drawn: &[(&TruthRange, f64)],
    ) -> Result<SimulationConfig, SetupError> {
        if ![start.x_m, start.y_m, start.yaw_rad]
            .into_iter()
            .all(in_hall)
        {
            return Err(SetupError::new("the start is not a place on a floor"));
        }
        let mut simulation = self.simulation.clone();
        simulation.seed = seed;
        simulation.car.start = start;
        let mut truth = self.truth.clone();
        for (range, value) in drawn {
            let section = truth
                .entry(range.section.clone())
                .or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(section) = section {
                section.insert(range.key.clone(), Value::Float(*value));
            }
        }
        if !truth.is_empty() {
            let truth: CarTruth = truth.try_into().map_err(SetupError::new)?;
            truth.apply(&mut simulation).map_err(SetupError::new)?;
        }
        Ok(simulation)
    }

    /// Where G must be for P to stand at `point`, with straight wheels.
    pub(crate) fn start(&self, point: [f64; 2], yaw_rad: f64) -> StartPose {
        let law = &self.config.law;
        let ahead = law.front_axle_distance_m + law.point_distance_m;
        start_of(point, ahead, yaw_rad)
    }
}

/// Whether a coordinate or an angle is that of a car.
pub(crate) fn in_hall(value: f64) -> bool {
    value.abs() <= 1e4
}

/// The section of a reference, from its TOML text.
pub(crate) fn reference(text: &str) -> Result<ReferenceSection, SetupError> {
    toml::from_str(text).map_err(|error| SetupError::new(format!("reference: {error}")))
}

fn parse(what: &str, text: &str) -> Result<Table, SetupError> {
    toml::from_str(text).map_err(|error| SetupError::new(format!("{what}: {error}")))
}
