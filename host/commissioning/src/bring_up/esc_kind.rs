//! What a pulse below neutral does: brake, reverse, or one after the other.

use singletrack_control::Time;
use singletrack_protocol::JOG_LIMIT_US;

use super::{
    car::{Car, armed},
    request::change,
    spin::{CREEPS, beyond, way},
};
use crate::{
    Bench, BoardReading, Finding, Interval, Jog, Parameter, Step, Trouble, finding::failed,
};

pub(super) const STEP: Step = Step::new("esc-kind", "What a pulse below neutral does", find)
    .expecting("board.esc.kind says what a pulse below neutral does.");

/// The speeds that the pulses below neutral would settle at if they drove, m/s: at rest, and at
/// speed with an ESC that has reverse, which should brake well. The board ends a jog beyond
/// 1.0. Without reverse the pulse at speed is as far as the board allows.
const AT_REST: f64 = 0.45;
const AT_SPEED: f64 = 0.85;

/// Longest pulse below neutral, s. The board takes a motor that is driven for 0.6 s without a
/// pulse for one without a sensor.
const PULSE_S: f64 = 0.5;

/// Wheels that speed up by half and by this, m/s, below neutral, have turned round. Pulses
/// that are far apart do not show how slow they were in between.
const TURNED: f64 = 0.08;

/// A brake stops the wheels within this part of the way of a roll-out.
const BRAKED: f64 = 0.85;

/// The speed before a roll-out and before a pulse below neutral, m/s.
const FROM_M_S: f64 = 0.65;

/// Measurements at speed of each, rolling and below neutral.
const TIMES: u32 = 2;

/// What pulses below neutral did.
#[derive(Debug)]
struct Seen {
    /// The first and the second pulse below neutral at rest turned the wheels.
    at_rest: [bool; 2],
    /// One at speed turned them round.
    turned_round: bool,
    /// Ways to standstill at neutral and below it, m.
    rolled_m: f64,
    braked_m: f64,
}

impl Seen {
    fn brakes(&self) -> bool {
        self.braked_m < BRAKED * self.rolled_m
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

fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let esc = bench.configuration().board.esc;
    let feed_forward = f64::from(bench.configuration().board.speed.feed_forward_us_per_m_s);
    let pulse_of = |speed: f64| {
        let offset_us = esc.deadband_us + (speed * feed_forward).round() as u16;
        beyond(esc.neutral_us, offset_us.min(JOG_LIMIT_US), false).max(esc.min_us)
    };
    let farthest_us = beyond(esc.neutral_us, JOG_LIMIT_US, false).max(esc.min_us);
    let mut brake_us = farthest_us;
    let seen = armed(bench, |car| {
        let at_rest = at_rest(car, pulse_of(AT_REST))?;
        if at_rest.contains(&true) {
            brake_us = pulse_of(AT_SPEED);
        }
        at_speed(car, at_rest, brake_us)
    })?;
    let found = format!(
        "at rest the first pulse below neutral {}, the second {}; at speed it {}: the wheels \
         stood after {:.2} m, after {:.2} m at neutral",
        turned(seen.at_rest[0]),
        turned(seen.at_rest[1]),
        if seen.turned_round {
            "turned the wheels round"
        } else if seen.brakes() {
            "braked"
        } else {
            "did not brake"
        },
        seen.braked_m,
        seen.rolled_m
    );
    let Some(kind) = seen.kind() else {
        let found = format!("{found}; no pulse below neutral had an effect");
        let fix = "None, if board.esc.kind is left out: no pulse below neutral is ever sent.";
        return Ok(Finding::warning(found, fix));
    };
    let kind_key = ("board.esc.kind", kind.into());
    if kind == "forward-reverse" {
        change(bench, std::slice::from_ref(&kind_key))?;
    } else {
        let brake = ("board.esc.brake_us", i64::from(brake_us).into());
        change(bench, &[kind_key.clone(), brake])?;
    }
    let finding = match bench.configuration().board.esc.kind {
        Some(_) => Finding::good(format!("\"{kind}\": {found}")),
        None => {
            let found = "board.esc.kind was not written";
            return Err(failed(found, "Write it by hand."));
        }
    };
    let mut kinds = ["car", "forward-reverse", "vesc"].into_iter();
    let number = kinds.position(|name| name == kind).unwrap_or(0);
    let number = Interval::around(number as f64, 0.0);
    let parameter = Parameter::new("esc-kind", "", number, Some(kind_key));
    Ok(finding.with(vec![parameter]))
}

const fn turned(turned: bool) -> &'static str {
    if turned {
        "turned the wheels"
    } else {
        "did not turn them"
    }
}

/// Whether the first and the second pulse below neutral turn wheels at rest.
fn at_rest(car: &mut Car<'_>, below_us: u16) -> Result<[bool; 2], Trouble> {
    let rest = car.rest();
    let below = rest.with_esc(below_us);
    car.hold_until_standing(rest, 1.0)?;
    let mut at_rest = [false; 2];
    for turned in &mut at_rest {
        let readings = car.hold(below, PULSE_S, "below neutral, at rest")?;
        *turned = readings.iter().any(BoardReading::turns);
        car.hold_until_standing(rest, 0.8)?;
    }
    Ok(at_rest)
}

/// What a pulse below neutral does to wheels that turn.
fn at_speed(car: &mut Car<'_>, at_rest: [bool; 2], brake_us: u16) -> Result<Seen, Trouble> {
    let rest = car.rest();
    let brake = rest.with_esc(brake_us);
    let mut seen = Seen {
        at_rest,
        turned_round: false,
        rolled_m: 0.0,
        braked_m: 0.0,
    };
    for _ in 0..TIMES {
        seen.rolled_m += slow_down(car, rest)?.0 / f64::from(TIMES);
        let (way, turned_round) = slow_down(car, brake)?;
        seen.braked_m += way / f64::from(TIMES);
        seen.turned_round |= turned_round;
    }
    Ok(seen)
}

/// Turns the motor, then gives the other pulse; the way to standstill, m, and whether
/// the wheels turned round.
fn slow_down(car: &mut Car<'_>, after: Jog) -> Result<(f64, bool), Trouble> {
    let rest = car.rest();
    let drive = car.spin(FROM_M_S)?;
    car.hold(drive, 0.3, "turning")?;
    let mut slow_since: Option<Time> = None;
    let mut slowest = f64::INFINITY;
    let mut turned_round = false;
    // Long enough for an ESC that drives backward at once, and no longer than a motor that
    // stands may be driven.
    let readings = car.hold_until(after, 0.9, "slowing down", |reading| {
        let now = reading.motor_speed.abs();
        slowest = slowest.min(now);
        if now > 1.5 * slowest + TURNED {
            turned_round = true;
            return true;
        }
        if now > CREEPS {
            slow_since = None;
            return false;
        }
        let since = *slow_since.get_or_insert(reading.receive);
        reading.receive.seconds_since(since) > 0.3
    })?;
    car.hold_until_standing(rest, 0.8)?;
    Ok((way(&readings), turned_round))
}
