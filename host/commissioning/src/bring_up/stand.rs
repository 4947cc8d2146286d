//! The car is on its stand, at rest and in view of the cameras.

use super::{car::Car, questions, request::ask_yes};
use crate::{Bench, BoardReading, Finding, Step, Trouble, finding::require};

/// Time for which the car must be at rest, s.
const WATCHED_S: f64 = 2.0;

pub(super) const STEP: Step = Step::new("stand", "The car on its stand", find)
    .expecting("All wheels are clear of the floor, the cameras see the car, and it stands still.");

pub(super) fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let is_on_stand = ask_yes(bench, &questions::ON_STAND)?;
    let fix = "Put a box under the chassis so that all wheels turn freely.";
    require(is_on_stand, "the car is not on a stand", fix)?;
    let mut car = Car::look(bench)?;
    let readings = car.watch(WATCHED_S, "standing")?;
    let turns = readings.iter().any(BoardReading::turns);
    let found = "the motor turns although the car is not armed";
    let fix = "Cut the supply of the ESC. Its neutral is not at 1500 us, or the pulse sensor picks \
               up interference: see docs/uno.md.";
    require(!turns, found, fix)?;
    Ok(Finding::good("the car stands still in view of the cameras"))
}
