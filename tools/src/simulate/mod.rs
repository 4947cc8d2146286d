//! Closed loops in virtual time, from a scenario file to a trajectory.

mod car;
mod ideal;
mod integrator;
mod row;
mod scenario;

pub use car::{CarError, virtual_drive_config};
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
}

/// What came of a scenario.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// The trajectory.
    pub rows: Vec<Row>,
    /// What a person should know of it.
    pub notes: Vec<String>,
}

/// Runs a scenario on the plant that it names.
///
/// # Errors
///
/// A scenario that can't be run, with the reason.
pub fn simulate(scenario: &Scenario) -> Result<Simulation, SimulateError> {
    Ok(match scenario.plant.kind {
        PlantKind::Ideal => Simulation {
            rows: ideal::simulate(scenario)?,
            notes: Vec::new(),
        },
        PlantKind::Car => car::simulate(scenario)?,
    })
}
