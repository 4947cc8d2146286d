//! Closed loops in virtual time.

mod ideal;
mod integrator;
mod row;
mod scenario;

pub use ideal::{IdealError, simulate};
pub use integrator::IntegrationError;
pub use row::{HEADER, Row, write_csv};
pub use scenario::{
    ControlSection, LawKind, LawSection, MarkerLoss, OuterLoopSection, PlantKind, PlantSection,
    ReferenceSection, RunSection, Scenario, ScenarioError, StartSection, SteeringHold, StepSection,
};
