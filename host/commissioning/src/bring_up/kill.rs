//! The kill, before anything turns for another reason.

use super::{
    car::{JOG_LIMIT_US, Outcome, Trouble, armed, ask, ask_yes, conclude, failed, mean_speed},
    questions,
};
use crate::{Bench, BoardReading, Finding, Interrupted};

/// Time for which an armed board holds neutral, s.
const ARMED_S: f64 = 1.0;

/// Time in which the operator cuts the supply, s. The board ends a jog after 10 s.
const CUT_WITHIN_S: f64 = 6.0;

/// Where the search for the first turn begins, beyond neutral, us.
const FROM_US: u16 = 16;

pub(super) const NAME: &str = "kill";

pub(super) fn run(bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
    let outcome = if bench.configuration().board.kill_output {
        by_board(bench)
    } else {
        by_hand(bench)
    };
    conclude(
        bench,
        NAME,
        "The supply of the ESC can be cut, whatever pulses it gets.",
        outcome,
    )
}

fn by_board(bench: &mut dyn Bench) -> Result<Outcome, Trouble> {
    const WIRING: &str = "Check the wiring of the kill output (pin D7) and of its relay, which is \
                          normally open: docs/uno.md.";
    let dark = |bench: &mut dyn Bench| ask_yes(bench, &questions::esc_dark());
    if !dark(bench)? {
        return Err(failed(
            "the ESC has its supply although the kill output is off",
            WIRING,
        ));
    }
    let power = armed(bench, |car| {
        let rest = car.rest();
        car.hold(rest, ARMED_S, "armed at neutral")?;
        Ok(car.status.is_some_and(|status| status.power_on))
    })?;
    if !power {
        return Err(failed(
            "the armed board does not hold its kill output",
            "Load the image again: `cargo uno`.",
        ));
    }
    if !ask_yes(bench, &questions::esc_woke())? {
        return Err(failed("the armed board does not switch the ESC on", WIRING));
    }
    if !dark(bench)? {
        return Err(failed(
            "the ESC keeps its supply after the board was disarmed",
            WIRING,
        ));
    }
    Ok(Outcome::good(
        "the ESC is on while the board is armed, and off before and after",
    ))
}

fn by_hand(bench: &mut dyn Bench) -> Result<Outcome, Trouble> {
    const NONE: &str = "Wire the kill output (docs/uno.md) and set board.kill_output, or put a \
                        switch that you reach at any time into the supply of the ESC.";
    if !ask_yes(bench, &questions::kill_switch())? {
        return Ok(Outcome::warning(
            "nothing but the pulses on one wire stops the motor",
            NONE,
        ));
    }
    ask(bench, &questions::cut_supply())?;
    let rolled_s = armed(bench, |car| {
        let Some(jog) = car.spin(FROM_US)? else {
            return Err(never_turned(JOG_LIMIT_US));
        };
        let before = car.hold(jog, 0.3, "cut the supply")?;
        let speed = mean_speed(&before);
        let begin = car.now()?;
        let readings = car.hold_until(jog, CUT_WITHIN_S, "cut the supply", |reading| {
            reading.motor_speed == 0.0
        });
        match readings {
            Ok(readings) => Ok(roll_down(&readings, speed).filter(|_| {
                readings
                    .last()
                    .is_some_and(|reading| reading.motor_speed == 0.0)
            })),
            // The board takes a motor that does not turn for one without a sensor.
            Err(Trouble::Ended { .. }) if car.board.is_some_and(|b| b.motor_speed == 0.0) => {
                Ok(Some(car.now()?.seconds_since(begin)))
            }
            Err(trouble) => Err(trouble),
        }
    })?;
    ask(bench, &questions::restore_supply())?;
    match rolled_s {
        Some(rolled_s) => Ok(Outcome::good(format!(
            "without its supply the motor came to rest within {rolled_s:.1} s, with the pulse \
             still driving it"
        ))),
        None => Err(failed(
            format!("the motor turned on for {CUT_WITHIN_S} s: the kill does not cut it"),
            NONE,
        )),
    }
}

/// Time from the last telemetry with nine tenths of the speed to rest, s.
fn roll_down(readings: &[BoardReading], speed: f64) -> Option<f64> {
    let end = readings.last()?.receive;
    let begin = readings
        .iter()
        .rev()
        .find(|reading| reading.motor_speed.abs() >= 0.9 * speed)?
        .receive;
    Some(end.seconds_since(begin))
}

/// The motor does not turn.
pub(super) fn never_turned(limit_us: u16) -> Trouble {
    failed(
        format!("no motor pulse up to {limit_us} us beyond neutral"),
        "Is the ESC on and started, with its battery charged? Are servo (D9) and ESC (D10) \
         swapped? Does the pulse sensor count when the wheels are turned by hand \
         (`singletrack doctor`)?",
    )
}
