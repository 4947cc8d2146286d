//! The cars of newcomers, from the parts to the first circle.
//!
//! `cargo onboard` takes random cars, of which each is truly something else than its owner has
//! written down, through doctor, bring-up and calibration. The procedures see the simulated car
//! through [`VirtualBench`], which is a [`Bench`](singletrack_commissioning::Bench); scripted
//! hands answer their questions.

mod bench;
mod campaign;
mod car;
mod circle;
mod guard;
mod person;
mod rehearsal;
mod truths;

pub use bench::{BenchError, VirtualBench};
pub use campaign::{
    Campaign, CampaignError, CarOutcome, Measured, NoJournal, Summary, onboard, onboard_until,
    write_csv,
};
pub use car::{HALL_M, OnboardCar, PlantedFault};
pub use circle::Circle;
pub use guard::{Guard, Violation};
pub use person::{Hands, Person};
pub use rehearsal::{Rehearsal, RehearsalError, RehearsedStep};
pub use singletrack_statistics::Random;
pub use truths::truth_of;
