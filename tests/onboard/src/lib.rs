//! The cars of newcomers, from the parts to the first circle.
//!
//! `cargo onboard` takes random cars, of which each is truly something else than its owner has
//! written down, through doctor, bring-up and calibration. The procedures see the simulated car
//! through [`VirtualBench`], which is a [`Bench`](singletrack_commissioning::Bench); scripted
//! hands answer their questions.

mod bench;
mod car;
mod person;
mod random;

pub use bench::{BenchError, Violation, VirtualBench};
pub use car::{HALL_M, OnboardCar, PlantedFault};
pub use random::Random;
