//! The cars of newcomers, from the parts to the first circle.
//!
//! `cargo onboard` takes random cars, of which each is truly something else than its owner has
//! written down, through doctor, bring-up and calibration. The procedures see the simulated car
//! through [`VirtualBench`], which is a [`Bench`](singletrack_commissioning::Bench); scripted
//! hands answer their questions.

mod bench;
mod campaign;
mod car;
mod guard;
mod person;

pub use bench::{BenchError, NoJournal, Rehearsal, RehearsalError, RehearsedStep, VirtualBench};
pub use campaign::{
    Campaign, CampaignError, CarOutcome, Circle, Measured, Summary, onboard, onboard_until,
    write_csv,
};
pub use car::{HALL_M, OnboardCar, PlantedFault, truth_of};
pub use guard::{Guard, Violation};
pub use person::{Hands, Person};
pub use singletrack_control::statistics::Random;
