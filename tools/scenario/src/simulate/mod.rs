//! Closed loops in virtual time, from a scenario file to a trajectory.

mod car;
mod error;
mod ideal;
mod operator;
mod row;
mod scenario;
mod summary;

use std::{fmt, path::Path};

pub use car::{CarError, RunOptions, drive_entries, simulate_configured, virtual_drive_config};
pub use error::ScenarioError;
pub use error::merge;
pub use ideal::IdealError;
pub use operator::OperatorSection;
pub use operator::TuneSection;
pub use row::{HEADER, Row, trim_zeros, write_csv};
pub use scenario::{
    ControlSection, MarkerLoss, PlantKind, PlantSection, RunSection, Scenario, StartSection,
    SteeringHold,
};
pub use singletrack_sim::integrator::IntegrationError;
pub use summary::{CalibrationLine, Summary};

use singletrack_control::CalibrationEstimate;

use crate::tracking::TrackingError;

/// A moment of the trajectory, in s.
const MOMENT: core::ops::RangeInclusive<f64> = 0.0..=86_400.0;

/// Why a simulation stopped.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// On the ideal plant.
    #[error(transparent)]
    Ideal(#[from] IdealError),
    /// On the car.
    #[error(transparent)]
    Car(#[from] CarError),
    /// The ideal plant has no pilot to record.
    #[error("there is nothing to record: plant.kind is \"ideal\", which has no pilot; use \"car\"")]
    NoPilot,
    /// The ideal plant has no pilot whose drive could be summed up.
    #[error("there is no summary: plant.kind is \"ideal\", which has no pilot; use \"car\"")]
    NoSummary,
}

impl fmt::Display for Simulation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.summary, self.tracking_error) {
            (Some(summary), _) => summary.fmt(formatter),
            (None, Some(error)) => error.fmt(formatter),
            (None, None) => Ok(()),
        }
    }
}

/// The result of a scenario.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// The trajectory.
    pub rows: Vec<Row>,
    /// Notes for the user.
    pub notes: Vec<String>,
    /// How far P was from its reference, in the rows in which the car follows it.
    pub tracking_error: Option<TrackingError>,
    /// What the drive came to; none on the ideal plant.
    pub summary: Option<Summary>,
    /// What the drive says about the calibration; empty if `online_calibration.mode` is "off".
    pub estimates: Vec<CalibrationEstimate>,
}

/// Runs a scenario on the plant that it names.
///
/// # Errors
///
/// The reason why the scenario can't be run.
pub fn simulate(scenario: &Scenario) -> Result<Simulation, SimulateError> {
    simulate_with(scenario, RunOptions::default())
}

/// Like [`simulate`], with options.
///
/// # Errors
///
/// The errors of [`simulate`] and [`simulate_recorded`]; the plant is ideal and a summary is
/// wanted.
pub fn simulate_with(
    scenario: &Scenario,
    options: RunOptions<'_>,
) -> Result<Simulation, SimulateError> {
    match scenario.plant.kind {
        PlantKind::Ideal if options.record.is_some() => Err(SimulateError::NoPilot),
        PlantKind::Ideal if options.summary => Err(SimulateError::NoSummary),
        PlantKind::Ideal => {
            let rows = ideal::simulate(scenario)?;
            let distances: Vec<_> = rows.iter().map(Row::distance_from_reference).collect();
            Ok(Simulation {
                rows,
                notes: Vec::new(),
                tracking_error: TrackingError::of(&distances),
                summary: None,
                estimates: Vec::new(),
            })
        }
        PlantKind::Car => {
            let (daemon, simulation) = virtual_drive_config(scenario)?;
            Ok(simulate_configured(
                scenario,
                &daemon,
                &simulation,
                options,
            )?)
        }
    }
}

/// Like [`simulate`], and writes a record of the drive to `path`.
///
/// # Errors
///
/// The errors of [`simulate`]; the plant is ideal and has no pilot; the file exists or
/// can't be written.
pub fn simulate_recorded(scenario: &Scenario, path: &Path) -> Result<Simulation, SimulateError> {
    simulate_with(
        scenario,
        RunOptions {
            record: Some(path),
            ..RunOptions::default()
        },
    )
}
