//! The motor: direction, deadband on both sides of neutral, feed-forward.
//!
//! The deadband is that of board.esc.deadband_us: the band of pulses in which the wheels
//! stand, with what the ESC ignores and what the drive train holds. Its edges come from the
//! speeds beyond it: a slow wheel gives too few pulses to tell one that stands from one that
//! creeps.

use singletrack_control::Time;

use super::{
    car::{
        Car, JOG_LIMIT_US, Outcome, Trouble, armed, ask_word, beyond, change, conclude, failed,
        mean_speed,
    },
    kill::never_turned,
    questions::{self, WAYS},
};
use crate::{
    Bench, BoardReading, Finding, Interrupted, Interval, Jog, Parameter,
    fit::{
        least_squares,
        speed_curve::{SpeedCurve, fit_speed_curve},
        student_quantile,
    },
};

pub(super) const DIRECTION: &str = "motor-direction";
pub(super) const MAP: &str = "motor-map";

/// Where the search for the first turn begins, beyond neutral, us.
const FROM_US: u16 = 16;

/// Time that a speed is given to settle, and in which it is measured, s.
const SETTLE_S: f64 = 0.7;
const MEASURE_S: f64 = 0.6;

/// Speeds that are measured, m/s. The board ends a jog beyond 1.0.
const SLOWEST: f64 = 0.06;
const FASTEST: f64 = 0.75;
/// Wanted change of the speed from one level to the next, m/s.
const STEP: f64 = 0.09;

/// Time for which the motor is driven without a rest, s. The board allows 10.
const DRIVEN_S: f64 = 5.0;

/// What the standing band may differ from its curve by, us: the first turn needs more than
/// the last one.
const BREAKAWAY_US: f64 = 1.0;

/// The speed for which the feed-forward is given, m/s.
const AT_SPEED: f64 = 0.5;

/// Change of the feed-forward with the charge of the battery.
const CHARGE: f64 = 0.06;

/// What a drive train holds beyond the band that the ESC ignores, us, where only the ESC's own
/// edge is seen on the other side: from nothing to twice this.
const HELD_US: f64 = 5.0;

/// The widest band that an ESC ignores, to one side, us.
const WIDEST_US: f64 = 60.0;

pub(super) fn direction(bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
    let outcome = find_direction(bench);
    conclude(
        bench,
        DIRECTION,
        "A pulse above neutral drives forward, and the motor's pulses count.",
        outcome,
    )
}

fn find_direction(bench: &mut dyn Bench) -> Result<Outcome, Trouble> {
    let turned = armed(bench, |car| {
        let Some(jog) = car.spin(FROM_US)? else {
            return Ok(None);
        };
        // For the operator to see.
        car.hold(jog, 1.0, "which way do the wheels turn?")?;
        Ok(Some(jog.esc_us))
    });
    let turned = match turned {
        // The motor may turn while its sensor does not count.
        Err(Trouble::Ended { cause, .. }) if cause.name() == "motor-sensor" => None,
        turned => turned?,
    };
    let seen = ask_word(bench, &questions::driven_wheels(), WAYS)?;
    match (turned, seen) {
        (Some(pulse_us), "forward") => Ok(Outcome::good(format!(
            "forward at {pulse_us} us, and the pulses count"
        ))),
        (Some(_), "backward") => Err(failed(
            "a pulse above neutral drives backward",
            "Swap two of the motor's wires (brushless: any two; brushed: both), or reverse the \
             direction in the settings of the ESC.",
        )),
        (Some(_), _) => Err(failed(
            "motor pulses came, and the driven wheels did not turn",
            "Does the drive train slip? Is D2 connected to the motor's sensor, and no other wire?",
        )),
        (None, "stood") => Err(never_turned(JOG_LIMIT_US)),
        (None, _) => Err(failed(
            "the wheels turned, and no motor pulse came",
            "Check the pulse sensor on D2: magnet, distance, supply.",
        )),
    }
}

pub(super) fn map(bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
    let outcome = find_map(bench);
    conclude(
        bench,
        MAP,
        "The wheels stand at board.esc.neutral_us plus and minus deadband_us, and turn beyond.",
        outcome,
    )
}

/// What lies below neutral.
enum Below {
    /// The wheels turn backward beyond this edge.
    Reverse(SpeedCurve),
    /// Beyond this edge the ESC brakes.
    Brake(Interval),
    /// Nothing that shows in the speed.
    Nothing,
}

fn find_map(bench: &mut dyn Bench) -> Result<Outcome, Trouble> {
    let (ahead, below) = armed(bench, |car| {
        let ahead = curve(car, true)?.ok_or_else(|| never_turned(JOG_LIMIT_US))?;
        let below = match curve(car, false)? {
            Some(curve) => Below::Reverse(curve),
            None => brake_edge(car, &ahead)?.map_or(Below::Nothing, Below::Brake),
        };
        Ok((ahead, below))
    })?;
    let esc = bench.configuration().board.esc;
    let configured = f64::from(esc.neutral_us);
    let upper = ahead.edge;
    // Both relative to the configured neutral.
    let (neutral, deadband, how) = match below {
        Below::Reverse(curve) => {
            let half = upper.half_width().hypot(curve.edge.half_width()) / 2.0;
            let lower = -curve.edge.value;
            (
                Interval::around(f64::midpoint(upper.value, lower), half),
                Interval::around((upper.value - lower) / 2.0, half),
                "turns both ways",
            )
        }
        Below::Brake(edge) => {
            // The ESC's own edge: on the other side the drive train holds a little more.
            let half = upper.half_width().hypot(edge.half_width()) / 2.0;
            let middle = f64::midpoint(upper.value - HELD_US, -edge.value);
            let neutral = Interval::around(middle, half).widened(HELD_US / 2.0);
            (
                neutral,
                Interval::around(upper.value - middle, half).widened(HELD_US / 2.0),
                "turns forward, brakes below neutral",
            )
        }
        Below::Nothing => {
            let neutral = Interval {
                value: 0.0,
                low: (upper.low - WIDEST_US).min(0.0),
                high: upper.high.max(0.0),
            };
            let deadband = Interval {
                value: upper.value,
                low: 0.0,
                high: WIDEST_US.max(upper.high),
            };
            (neutral, deadband, "turns forward only")
        }
    };
    let neutral = neutral.shifted(configured);
    let neutral_us = neutral.value.round();
    // The band between both edges, whatever the rounding does.
    let band = (upper.value - (neutral_us - configured))
        .min(deadband.value + (deadband.value - 0.5).clamp(0.0, 0.5))
        .floor()
        .clamp(0.0, 200.0);
    if (neutral_us - 1_500.0).abs() > band {
        return Err(failed(
            format!(
                "the wheels stand from {:.0} to {:.0} us: not at 1500 us, which the board gives \
                 before it is configured",
                neutral.value - deadband.value,
                neutral.value + deadband.value
            ),
            "Calibrate the neutral of the ESC to 1500 us as its manual says.",
        ));
    }
    let feed_forward = ahead
        .feed_forward
        .widened(CHARGE * ahead.feed_forward.value);
    let integer = |value: f64| toml_edit::Value::from(value as i64);
    let keys = [
        ("board.esc.neutral_us", integer(neutral_us)),
        ("board.esc.deadband_us", integer(band)),
        (
            "board.speed.feed_forward_us_per_m_s",
            integer(feed_forward.value.round().clamp(0.0, 5_000.0)),
        ),
    ];
    change(bench, &keys)?;
    let found = format!(
        "{how}: neutral {:.1} us (to {:.1}), deadband {:.1} us (to {:.1}), {:.0} us per m/s at \
         {AT_SPEED} m/s; the speeds are within {:.1} us of their curve",
        neutral.value,
        neutral.half_width(),
        deadband.value,
        deadband.half_width(),
        feed_forward.value,
        ahead.scatter
    );
    let [neutral_key, deadband_key, feed_forward_key] = keys;
    let outcome = if ahead.scatter > 4.0 {
        Outcome::warning(
            found,
            "The speed is not steady at a steady pulse: does the drive train drag, or D2 pick up \
             interference?",
        )
    } else {
        Outcome::good(found)
    };
    Ok(outcome.with(vec![
        Parameter {
            name: "esc-neutral",
            unit: "us",
            estimate: neutral,
            key: Some(neutral_key),
        },
        Parameter {
            name: "esc-deadband",
            unit: "us",
            estimate: deadband,
            key: Some(deadband_key),
        },
        Parameter {
            name: "feed-forward",
            unit: "us/(m/s)",
            estimate: feed_forward,
            key: Some(feed_forward_key),
        },
    ]))
}

/// The settled speeds on one side of neutral; nothing if the wheels do not turn there.
fn curve(car: &mut Car<'_>, forward: bool) -> Result<Option<SpeedCurve>, Trouble> {
    let Some(first) = car.first_turn(forward, FROM_US)? else {
        return Ok(None);
    };
    let levels = levels(car, forward, first)?;
    fit_speed_curve(&levels, BREAKAWAY_US, AT_SPEED)
        .map(Some)
        .ok_or_else(|| {
            failed(
                format!(
                    "{} settled speeds give no curve of speed over pulse",
                    levels.len()
                ),
                "The motor turns too fast or too unsteadily within 150 us of neutral: reduce the \
                 power in the settings of the ESC, and check the pulse sensor.",
            )
        })
}

/// Pulses beyond neutral and their settled speeds, up and down again.
fn levels(car: &mut Car<'_>, forward: bool, first: Jog) -> Result<Vec<[f64; 2]>, Trouble> {
    let rest = car.rest();
    let mut offset_us = rest.esc_us.abs_diff(first.esc_us);
    let mut since = car.now()?;
    let mut levels = Vec::new();
    let mut last: Option<(u16, f64)> = None;
    let mut way_up = Vec::new();
    while offset_us <= JOG_LIMIT_US && way_up.len() < 24 {
        let speed = settled(car, &mut since, forward, offset_us)?;
        if speed >= SLOWEST {
            levels.push([offset_us.into(), speed]);
            way_up.push(offset_us);
        }
        if speed >= FASTEST {
            break;
        }
        let step_us = match last {
            Some((before_us, before)) if speed > before => {
                let per_us = (speed - before) / f64::from(offset_us - before_us);
                (STEP.min(0.9 - speed) / per_us).floor().clamp(2.0, 16.0) as u16
            }
            _ => 4,
        };
        last = Some((offset_us, speed));
        offset_us += step_us;
    }
    for offset_us in way_up.into_iter().rev() {
        let speed = settled(car, &mut since, forward, offset_us)?;
        if speed >= SLOWEST {
            levels.push([offset_us.into(), speed]);
        }
    }
    car.hold_until_standing(rest, 0.8)?;
    Ok(levels)
}

/// The settled speed at this pulse, m/s, after a rest if the motor has been driven for long.
fn settled(
    car: &mut Car<'_>,
    since: &mut Time,
    forward: bool,
    offset_us: u16,
) -> Result<f64, Trouble> {
    let rest = car.rest();
    if car.now()?.seconds_since(*since) > DRIVEN_S - SETTLE_S - MEASURE_S {
        car.hold_until_standing(rest, 0.8)?;
        *since = car.now()?;
    }
    let jog = Jog {
        esc_us: beyond(rest.esc_us, offset_us, forward),
        ..rest
    };
    car.hold(jog, SETTLE_S, "settling")?;
    Ok(mean_speed(&car.hold(jog, MEASURE_S, "measuring")?))
}

/// Pulse below neutral beyond which a turning motor is braked, us, from how much faster it
/// slows down the farther below neutral the pulse is.
fn brake_edge(car: &mut Car<'_>, ahead: &SpeedCurve) -> Result<Option<Interval>, Trouble> {
    /// Pulses below neutral, us. A steady brake grows with them.
    const PULSES_US: [u16; 7] = [30, 40, 50, 60, 70, 80, 90];
    let mut slowing = |offset_us: u16| {
        let speed_us = ahead.pulse(0.7).round().clamp(0.0, 150.0) as u16;
        slows_down(car, speed_us, offset_us)
    };
    let free = [slowing(0)?, slowing(0)?];
    let [Some(first), Some(second)] = free else {
        return Ok(None);
    };
    let free = f64::midpoint(first, second);
    let mut braked = Vec::new();
    for offset_us in PULSES_US.into_iter().chain(PULSES_US.into_iter().rev()) {
        if let Some(deceleration) = slowing(offset_us)? {
            // What differs from rolling only by its own scatter is not braked.
            if deceleration - free > 0.25 + 3.0 * (first - second).abs() {
                braked.push((deceleration - free, f64::from(offset_us)));
            }
        }
    }
    let Some(fit) = least_squares(braked.iter().map(|(by, at)| ([1.0, *by], *at))) else {
        return Ok(None);
    };
    let freedom = braked.len().saturating_sub(2);
    if freedom < 3 || fit.parameters[1] <= 0.0 {
        return Ok(None);
    }
    let half = student_quantile(freedom) * fit.standard_errors[0];
    // Edges of an ESC are not sharp to a microsecond.
    Ok(Some(Interval::around(fit.parameters[0], half).widened(2.0)))
}

/// How fast the wheels slow down at this pulse below neutral, m/s².
fn slows_down(car: &mut Car<'_>, ahead_us: u16, offset_us: u16) -> Result<Option<f64>, Trouble> {
    let rest = car.rest();
    car.hold_until_standing(rest, 0.8)?;
    let drive = Jog {
        esc_us: beyond(rest.esc_us, ahead_us, true),
        ..rest
    };
    car.hold(drive, 1.2, "turning")?;
    let begin = car.now()?;
    let slow = Jog {
        esc_us: beyond(rest.esc_us, offset_us, false),
        ..rest
    };
    let readings = car.hold(slow, 0.4, "slowing down")?;
    let line = |reading: &BoardReading| {
        let at = reading.receive.seconds_since(begin);
        (at > 0.08 && reading.motor_speed.abs() > 0.15)
            .then_some(([1.0, at], reading.motor_speed.abs()))
    };
    let fit = least_squares(
        readings
            .iter()
            .map_while(|reading| {
                let early = reading.receive.seconds_since(begin) <= 0.08;
                if early {
                    Some(None)
                } else {
                    line(reading).map(Some)
                }
            })
            .flatten(),
    );
    Ok(fit
        .filter(|fit| fit.count >= 4)
        .map(|fit| -fit.parameters[1]))
}
