//! The kill switch, before a step depends on it.

use singletrack_protocol::JOG_LIMIT_US;

use super::{
    car::armed,
    questions,
    request::{ask, ask_yes},
};
use crate::{
    Bench, BoardReading, Finding, Step, Trouble,
    finding::{failed, require},
};

/// Time for which an armed board holds neutral, s.
const ARMED_S: f64 = 1.0;

/// Time that the operator has to cut the supply, s. The board ends a jog after 10 s.
const CUT_WITHIN_S: f64 = 6.0;

/// Where the search for the first turn begins, beyond neutral, us.
const FROM_US: u16 = 16;

pub(super) const STEP: Step = Step::new("kill", "The kill switch of the ESC's supply", find)
    .expecting("The supply of the ESC can be cut, also while its pulse drives the motor.");

pub(super) fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    if bench.configuration().board.kill_output {
        by_board(bench)
    } else {
        by_hand(bench)
    }
}

fn by_board(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    const WIRING: &str = "Check the wiring of the kill output (pin D7) and of its relay, which is \
                          normally open: docs/uno.md.";
    let dark = |bench: &mut dyn Bench| ask_yes(bench, &questions::ESC_DARK);
    let found = "the ESC has its supply although the kill output is off";
    require(dark(bench)?, found, WIRING)?;
    let power = armed(bench, |car| {
        let rest = car.rest();
        car.hold(rest, ARMED_S, "armed at neutral")?;
        Ok(car.status.is_some_and(|status| status.power_on))
    })?;
    let found = "the armed board does not hold its kill output";
    require(power, found, "Load the image again: `cargo uno`.")?;
    let found = "the armed board does not switch the ESC on";
    require(ask_yes(bench, &questions::ESC_WOKE)?, found, WIRING)?;
    let found = "the ESC keeps its supply after the board was disarmed";
    require(dark(bench)?, found, WIRING)?;
    let found = "the ESC is on while the board is armed, and off before and after";
    Ok(Finding::good(found))
}

fn by_hand(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    const NONE: &str = "Wire the kill output (docs/uno.md) and set board.kill_output, or put a \
                        switch that you reach at any time into the supply of the ESC.";
    if !ask_yes(bench, &questions::KILL_SWITCH)? {
        let found = "nothing but the pulses on one wire stops the motor";
        return Ok(Finding::warning(found, NONE));
    }
    ask(bench, &questions::CUT_SUPPLY)?;
    let spun = armed(bench, |car| {
        car.spin_for_hand(FROM_US, CUT_WITHIN_S, "cut the supply")
    })?;
    ask(bench, &questions::RESTORE_SUPPLY)?;
    let found =
        format!("the motor kept turning for {CUT_WITHIN_S} s: the kill switch does not cut it");
    require(spun.stopped_under_drive(), found, NONE)?;
    Ok(Finding::good(format!(
        "without its supply the motor came to rest within {:.1} s, with the pulse still driving it",
        roll_down(&spun.readings, spun.fastest())
    )))
}

/// Time from the last telemetry with nine tenths of the speed to rest, s.
fn roll_down(readings: &[BoardReading], speed: f64) -> f64 {
    let begin = readings
        .iter()
        .rev()
        .find(|reading| reading.motor_speed.abs() >= 0.9 * speed);
    match (begin, readings.last()) {
        (Some(begin), Some(end)) => end.receive.seconds_since(begin.receive),
        _ => 0.0,
    }
}

/// The trouble of a motor that gave no pulse as far from neutral as the board allows.
pub(super) fn never_turned() -> Trouble {
    let found = format!("no motor pulse up to {JOG_LIMIT_US} us beyond neutral");
    let fix = "Is the ESC on and started, with its battery charged? Are servo (D9) and ESC (D10) \
               swapped? Does the pulse sensor count when the wheels are turned by hand \
               (`singletrack doctor`)?";
    failed(found, fix)
}
