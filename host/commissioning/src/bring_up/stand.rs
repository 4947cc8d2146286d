//! The car is on its stand, at rest and in view of the cameras.

use super::{car::Car, questions, request::ask_yes};
use crate::{Bench, BoardReading, Finding, Step, Trouble, finding::failed};

/// Time for which the car must be at rest, s.
const WATCHED_S: f64 = 2.0;

pub(super) const STEP: Step = Step::new("stand", "The car on its stand", find)
    .expecting("All wheels are clear of the floor, the cameras see the car, and it stands still.");

pub(super) fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    if !ask_yes(bench, &questions::ON_STAND)? {
        return Err(failed(
            "the car is not on a stand",
            "Put a box under the chassis so that all wheels turn freely.",
        ));
    }
    let mut car = Car::look(bench)?;
    let readings = car.watch(WATCHED_S, "standing")?;
    if readings.iter().any(BoardReading::turns) {
        return Err(failed(
            "the motor turns although the car is not armed",
            "Cut the supply of the ESC. Its neutral is not at 1500 us, or the pulse sensor \
             picks up interference: see docs/uno.md.",
        ));
    }
    Ok(Finding::good("the car stands still in view of the cameras"))
}
