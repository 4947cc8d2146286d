//! The wheels stand at the neutral of the ESC, whether ESC or board is switched on first.

use super::{
    car::{Car, armed},
    questions,
    request::{ask, ask_yes},
};
use crate::{
    Bench, BoardReading, Finding, Step, Trouble,
    finding::{failed, require},
};

/// The step, watching for `SECONDS` in each order of switching on.
pub(super) const fn step_with<const SECONDS: u32>() -> Step {
    let find = |bench: &mut dyn Bench| find(bench, SECONDS.into());
    Step::new("esc-neutral", "The ESC at neutral", find).expecting(
        "No pulse of the motor at neutral, with the ESC switched on before and after the board.",
    )
}

/// Most milliseconds of this step in which the board may refuse edges of the sensor.
const REFUSED: u16 = 2;

fn find(bench: &mut dyn Bench, seconds: f64) -> Result<Finding, Trouble> {
    let orders = if bench.configuration().board.kill_output {
        // The board starts the ESC: there is one order.
        let readings = armed(bench, |car| {
            let rest = car.rest();
            watch(car, |car| car.hold(rest, seconds, "armed at neutral"))
        })?;
        check(&readings, "after the board")?;
        still(bench)?;
        "the board starts the ESC"
    } else {
        for (question, order) in [
            (questions::ESC_AFTER_BOARD, "after the board"),
            (questions::BOARD_AFTER_ESC, "before the board"),
        ] {
            ask(bench, &question)?;
            let mut car = Car::look(bench)?;
            let readings = watch(&mut car, |car| car.watch(seconds, "at neutral"))?;
            check(&readings, order)?;
            still(bench)?;
        }
        "ESC on before and after the board"
    };
    let found = format!("no motor pulse in {seconds:.0} s at neutral: {orders}");
    Ok(Finding::good(found))
}

/// Takes readings, and fails if the board refused edges of the sensor meanwhile.
fn watch(
    car: &mut Car<'_>,
    mut readings: impl FnMut(&mut Car<'_>) -> Result<Vec<BoardReading>, Trouble>,
) -> Result<Vec<BoardReading>, Trouble> {
    let refused = |car: &Car<'_>| car.status.map(|status| status.edges_refused);
    let before = refused(car);
    let readings = readings(car)?;
    if let (Some(before), Some(after)) = (before, refused(car)) {
        let noisy = after.wrapping_sub(before);
        let found = format!("interference on the pulse sensor's wire in {noisy} ms");
        let fix = "Keep the wire of D2 away from the motor's; 1 kOhm and 10 nF at the pin: \
                   docs/uno.md.";
        require(noisy <= REFUSED, found, fix)?;
    }
    Ok(readings)
}

fn check(readings: &[BoardReading], order: &str) -> Result<(), Trouble> {
    let Some(last) = readings.last() else {
        let found = "the board sent no telemetry";
        let fix = "Check the serial line with `singletrack doctor`.";
        return Err(failed(found, fix));
    };
    let esc_us = last.esc_us;
    let found = format!("the motor turned at {esc_us} us with the ESC switched on {order}");
    let fix = "Calibrate the neutral of the ESC to 1500 us as its manual says (most learn it with \
               the throttle at rest), or write its neutral to board.esc.neutral_us.";
    require(!readings.iter().any(BoardReading::turns), found, fix)
}

fn still(bench: &mut dyn Bench) -> Result<(), Trouble> {
    let is_still = ask_yes(bench, &questions::WHEELS_STILL)?;
    let found = "the wheels turned at neutral, and no motor pulse came";
    let fix = "Calibrate the neutral of the ESC as its manual says. Check the pulse sensor.";
    require(is_still, found, fix)
}
