//! The configuration of a simulated car from a few keys: what is believed of it and what is true.

use serde::de::DeserializeOwned;
use singletrack_core::config::{Config, ReferenceSection};
use singletrack_sim::{CarTruth, SimulationConfig, StartPose};
use toml::{Table, Value};

use crate::simulated::{Drive, daemon_config, follow, merge, start_of};

/// Why a simulation can't be set up; the text names the key.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SetupError(String);

impl SetupError {
    /// With the text of another error.
    #[expect(clippy::needless_pass_by_value, reason = "for map_err")]
    pub fn new(text: impl ToString) -> Self {
        Self(text.to_string().trim_end().to_owned())
    }
}

/// A named number of the table `[truth]`, such as `servo.lag_ms`.
#[derive(Clone, Debug)]
pub struct TruthRange {
    /// Name of the section, such as `servo`.
    pub section: String,
    /// Name of the key, such as `lag_ms`.
    pub key: String,
    /// The smallest value, in the key's unit.
    pub low: f64,
    /// The largest value, in the key's unit.
    pub high: f64,
}

/// What is believed and what is true of a simulated car.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The daemon's configuration: what is believed.
    pub config: Config,
    /// The car as it is believed to be; [`Setup::simulation`] adds the truth.
    pub simulation: SimulationConfig,
    truth: Table,
}

impl Setup {
    /// `configuration` holds keys of the daemon's configuration that differ from those of
    /// the simulated car, `truth` what is true of the car and differs from the configuration.
    ///
    /// # Errors
    ///
    /// One of the texts is not TOML, or the configuration is refused.
    pub fn new(
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

    /// The simulation of one car of this kind, with values drawn for keys of `[truth]`.
    ///
    /// # Errors
    ///
    /// The start is not finite or too far away, or a key of the truth is refused.
    pub fn simulation(
        &self,
        seed: u64,
        start: StartPose,
        drawn: &[(&TruthRange, f64)],
    ) -> Result<SimulationConfig, SetupError> {
        check_place("the start", &start)?;
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

    /// Where G must be for P to stand at `point` (m), with straight wheels.
    pub fn start(&self, point: [f64; 2], yaw_rad: f64) -> StartPose {
        let law = &self.config.law;
        let ahead = law.front_axle_distance_m + law.point_distance_m;
        start_of(point, ahead, yaw_rad)
    }
}

/// Whether a coordinate in m, or an angle in rad, is that of a car.
pub(super) fn in_hall(value: f64) -> bool {
    value.abs() <= 1e4
}

/// Refuses a place that no car has.
pub(super) fn check_place(what: &str, place: &StartPose) -> Result<(), SetupError> {
    match [place.x_m, place.y_m, place.yaw_rad]
        .into_iter()
        .all(in_hall)
    {
        true => Ok(()),
        false => Err(SetupError::new(format!("{what} is not a place on a floor"))),
    }
}

/// The section of a reference, from its TOML text.
///
/// # Errors
///
/// The text is no reference.
pub fn reference(text: &str) -> Result<ReferenceSection, SetupError> {
    parse("reference", text)
}

fn parse<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, SetupError> {
    toml::from_str(text).map_err(|error| SetupError::new(format!("{what}: {error}")))
}

/// The value of a word.
///
/// # Errors
///
/// The word is not known; the text lists those that are.
pub fn choice<T: Copy>(name: &str, word: &str, known: &[(&str, T)]) -> Result<T, SetupError> {
    let found = known.iter().find(|(known, _)| *known == word);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<String> = known.iter().map(|(word, _)| format!("{word:?}")).collect();
        SetupError::new(format!("{name} is {word:?}: use {}", words.join(" or ")))
    })
}
