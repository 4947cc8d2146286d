//! Closed loops in virtual time, from a scenario file to a trajectory.

mod car;
mod ideal;
mod integrator;
mod row;
mod scenario;

use std::path::Path;

pub use car::{CarError, drive_entries, virtual_drive_config};
pub use ideal::IdealError;
pub use integrator::IntegrationError;
pub use row::{HEADER, Row, write_csv};
pub use scenario::{
    ControlSection, MarkerLoss, PlantKind, PlantSection, RunSection, Scenario, ScenarioError,
    StartSection, SteeringHold,
};

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
}

/// The result of a scenario.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// The trajectory.
    pub rows: Vec<Row>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Runs a scenario on the plant that it names.
///
/// # Errors
///
/// The reason why the scenario can't be run.
pub fn simulate(scenario: &Scenario) -> Result<Simulation, SimulateError> {
    Ok(match scenario.plant.kind {
        PlantKind::Ideal => Simulation {
            rows: ideal::simulate(scenario)?,
            notes: Vec::new(),
        },
        PlantKind::Car => car::simulate(scenario, None)?,
    })
}

/// Like [`simulate`], and writes a record of the drive to `path`.
///
/// # Errors
///
/// The errors of [`simulate`]; the plant is ideal and has no pilot; the file exists or
/// can't be written.
pub fn simulate_recorded(scenario: &Scenario, path: &Path) -> Result<Simulation, SimulateError> {
    match scenario.plant.kind {
        PlantKind::Ideal => Err(SimulateError::NoPilot),
        PlantKind::Car => Ok(car::simulate(scenario, Some(path))?),
    }
}
