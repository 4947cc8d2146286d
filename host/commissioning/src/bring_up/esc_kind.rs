//! What a pulse below neutral does: brake, reverse, or one after the other.

use singletrack_control::Time;

use super::{
    car::{Car, Outcome, Trouble, armed, beyond, change, conclude, failed, mean_speed},
    kill::never_turned,
};
use crate::{Bench, BoardReading, Finding, Interrupted, Interval, Jog, Parameter};

pub(super) const NAME: &str = "esc-kind";

/// How far beyond the deadband the pulses of this step are, us.
const BEYOND_US: u16 = 60;

/// Longest pulse below neutral, s. The board takes a motor that is driven for 0.6 s without a
/// pulse for one without a sensor.
const PULSE_S: f64 = 0.5;

/// Wheels slower than this count as standing here, m/s.
const SLOW: f64 = 0.12;

/// Wheels that speed up by half and by this, m/s, below neutral, have turned round. Pulses
/// that are far apart do not show how slow they were in between.
const TURNED: f64 = 0.08;

/// A brake stops the wheels in this part of the time that they take to roll out.
const BRAKED: f64 = 0.75;

pub(super) fn run(bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
    let outcome = find(bench);
    conclude(
        bench,
        NAME,
        "board.esc.kind says what a pulse below neutral does.",
        outcome,
    )
}

/// What pulses below neutral did.
#[derive(Debug)]
struct Seen {
    /// The first and the second pulse below neutral at rest turned the wheels.
    at_rest: [bool; 2],
    /// One at speed turned them round.
    turned_round: bool,
    /// Times to slow down at neutral and below it, s.
    rolled_s: f64,
    braked_s: f64,
}

impl Seen {
    fn brakes(&self) -> bool {
        self.braked_s < BRAKED * self.rolled_s
    }

    fn kind(&self) -> Option<&'static str> {
        if self.turned_round {
            Some("forward-reverse")
        } else if self.at_rest.contains(&true) {
            Some("car")
        } else {
            self.brakes().then_some("vesc")
        }
    }
}

fn find(bench: &mut dyn Bench) -> Result<Outcome, Trouble> {
    let esc = bench.configuration().board.esc;
    let below_us = beyond(esc.neutral_us, esc.deadband_us + BEYOND_US, false).max(esc.min_us);
    let seen = armed(bench, |car| look(car, below_us))?;
    let found = format!(
        "at rest the first pulse below neutral {}, the second {}; at speed it {}: {:.2} s to slow \
         down, {:.2} s at neutral",
        turned(seen.at_rest[0]),
        turned(seen.at_rest[1]),
        if seen.turned_round {
            "turned the wheels round"
        } else if seen.brakes() {
            "braked"
        } else {
            "did not brake"
        },
        seen.braked_s,
        seen.rolled_s
    );
    let Some(kind) = seen.kind() else {
        return Ok(Outcome::warning(
            format!("{found}; no pulse below neutral did anything"),
            "None, if board.esc.kind is left out: no pulse below neutral is ever sent.",
        ));
    };
    if kind == "car" && !seen.brakes() {
        return Ok(Outcome::warning(
            format!("{found}; it drives in reverse from rest and does not brake at speed"),
            "Leave board.esc.kind out, and failsafe = \"coast\"; or set up the brake of the ESC.",
        ));
    }
    let kind_key = ("board.esc.kind", kind.into());
    if kind == "forward-reverse" {
        change(bench, std::slice::from_ref(&kind_key))?;
    } else {
        let brake = ("board.esc.brake_us", i64::from(below_us).into());
        change(bench, &[kind_key.clone(), brake])?;
    }
    let outcome = match bench.configuration().board.esc.kind {
        Some(_) => Outcome::good(format!("\"{kind}\": {found}")),
        None => {
            return Err(failed(
                "board.esc.kind was not written",
                "Write it by hand.",
            ));
        }
    };
    let number = ["car", "forward-reverse", "vesc"]
        .iter()
        .position(|name| *name == kind)
        .unwrap_or(0);
    Ok(outcome.with(vec![Parameter {
        name: "esc-kind",
        unit: "",
        estimate: Interval::around(number as f64, 0.0),
        key: Some(kind_key),
    }]))
}

const fn turned(turned: bool) -> &'static str {
    if turned {
        "turned the wheels"
    } else {
        "did not turn them"
    }
}

fn look(car: &mut Car<'_>, below_us: u16) -> Result<Seen, Trouble> {
    let rest = car.rest();
    let below = Jog {
        esc_us: below_us,
        ..rest
    };
    car.hold_until_standing(rest, 1.0)?;
    let mut at_rest = [false; 2];
    for turned in &mut at_rest {
        let readings = car.hold(below, PULSE_S, "below neutral, at rest")?;
        *turned = readings.iter().any(|reading| reading.motor_speed != 0.0);
        car.hold_until_standing(rest, 0.8)?;
    }
    let (rolled_s, _) = slow_down(car, rest)?;
    let (braked_s, turned_round) = slow_down(car, below)?;
    Ok(Seen {
        at_rest,
        turned_round,
        rolled_s,
        braked_s,
    })
}

/// Turns the motor, then gives the other pulse; the time to half of the speed, s, and whether
/// the wheels turned round.
fn slow_down(car: &mut Car<'_>, after: Jog) -> Result<(f64, bool), Trouble> {
    let rest = car.rest();
    let deadband_us = car.bench().configuration().board.esc.deadband_us;
    let Some(drive) = car.spin(deadband_us + 4)? else {
        return Err(never_turned(super::car::JOG_LIMIT_US));
    };
    let speed = mean_speed(&car.hold(drive, 0.4, "turning")?);
    let begin = car.now()?;
    let mut slow_since: Option<Time> = None;
    // Long enough for an ESC that drives backward at once, and no longer than a motor that
    // stands may be driven.
    let readings = car.hold_until(after, 0.9, "slowing down", |reading| {
        let now = reading.motor_speed.abs();
        if now > SLOW {
            slow_since = None;
            return false;
        }
        let since = *slow_since.get_or_insert(reading.receive);
        reading.receive.seconds_since(since) > 0.3
    })?;
    car.hold_until_standing(rest, 0.8)?;
    let half = |reading: &&BoardReading| reading.motor_speed.abs() < speed / 2.0;
    let slowed_s = readings
        .iter()
        .find(half)
        .map_or(0.9, |reading| reading.receive.seconds_since(begin));
    Ok((slowed_s, turns_round(&readings)))
}

/// Whether the wheels slowed down and then turned faster again.
fn turns_round(readings: &[BoardReading]) -> bool {
    let mut slowest = f64::INFINITY;
    readings.iter().any(|reading| {
        let speed = reading.motor_speed.abs();
        slowest = slowest.min(speed);
        speed > 1.5 * slowest + TURNED
    })
}
