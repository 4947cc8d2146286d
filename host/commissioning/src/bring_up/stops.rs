//! Every way to stop, at speed.
//!
//! Two times are measured for each: from the request to the neutral pulse, and from there
//! until the wheels begin to slow down, which is the time for which the ESC holds its last pulse.
//! A hand that pulls a cable or presses a button gives no time stamp: there the board's own record
//! counts, whether it kept its power, or what the operator sees.

use singletrack_control::Time;
use singletrack_protocol::ResetCause;

use super::{
    car::{CHECK_LINE, Car, armed},
    motor::{SPIN_M_S, Spun, mean_speed},
};
use crate::{
    Bench, BoardReading, Finding, Interval, Parameter, Trouble, Verdict,
    finding::{failed, require},
};

/// From a request to the neutral pulse at most, s.
const PULSE_WITHIN_S: f64 = 0.2;

/// The hold of a jog, s: from the last one to the request of the daemon.
const HOLD_S: f64 = 0.25;

/// From the neutral pulse until the wheels begin to slow down at most, s, and a pulse of the
/// motor in which that can't be seen.
const ESC_WITHIN_S: f64 = 0.2;

/// Part of the speed that shows that the wheels slow down.
const SLOWER: f64 = 0.92;

/// Time that the operator has to act, s. The board ends a jog after 10 s.
const HAND_S: f64 = 5.0;

/// Time for which a stop is watched, s.
const WATCHED_S: f64 = 3.0;

/// The time between two records of the board, s.
const RECORD_S: f64 = 0.01;

const ESC_HOLDS: &str = "Set the time-out of the ESC for lost pulses to 100 ms or less, and its \
                         drag brake as you like. See docs/safety.md.";

const OWN_SUPPLY: &str = "Give the board a supply of its own at VIN, or wire the kill output: see \
                          docs/uno.md. Set the time-out of the ESC for lost pulses to 100 ms or \
                          less.";

/// The times of a stop.
struct Stop {
    /// To the neutral pulse, s; none if it did not come.
    pulse_s: Option<f64>,
    /// From there until the wheels slow down, s; none if they do not.
    slower_s: Option<f64>,
    /// One pulse of the motor at the speed, s.
    blind_s: f64,
    speed: f64,
}

/// Turns the motor at about 0.5 m/s, and watches how this request stops it.
fn stopped<'a>(
    car: &mut Car<'a>,
    request: fn(&mut Car<'a>) -> Result<(), Trouble>,
) -> Result<Stop, Trouble> {
    let jog = car.spin(SPIN_M_S)?;
    let speed = mean_speed(&car.hold(jog, 0.4, "turning")?);
    request(car)?;
    let begin = car.now;
    let readings = car.watch(WATCHED_S, "stopping")?;
    Ok(evaluate(car, &readings, begin, speed))
}

fn evaluate(car: &mut Car<'_>, readings: &[BoardReading], begin: Time, speed: f64) -> Stop {
    let board = car.bench().configuration().board;
    let is_neutral = |reading: &&BoardReading| {
        reading.esc_us.abs_diff(board.esc.neutral_us) <= board.esc.deadband_us
            || [0, 1_500].contains(&reading.esc_us)
    };
    let neutral = readings.iter().find(is_neutral);
    let neutral = neutral.map(|reading| reading.receive);
    let slower = neutral.and_then(|neutral| {
        let mut later = readings.iter().filter(|reading| reading.receive >= neutral);
        let slower = later.find(|reading| reading.motor_speed.abs() < SLOWER * speed)?;
        Some(slower.receive.seconds_since(neutral))
    });
    Stop {
        pulse_s: neutral.map(|neutral| neutral.seconds_since(begin)),
        slower_s: slower,
        blind_s: f64::from(board.speed.pulse_distance_um) * 1e-6 / speed.max(0.1),
        speed,
    }
}

impl Stop {
    fn finding(&self, name: &'static str, within_s: f64) -> Result<Finding, Trouble> {
        let Some(pulse_s) = self.pulse_s else {
            let fix = "Cut the supply of the ESC. See the log of the daemon.";
            return Err(failed("the pulse did not go to neutral", fix));
        };
        let Some(slower_s) = self.slower_s else {
            let found = format!(
                "the wheels kept {:.2} m/s for {WATCHED_S:.0} s after the pulse was neutral",
                self.speed
            );
            let fix = "Cut the supply of the ESC: it does not obey neutral.";
            return Err(failed(found, fix));
        };
        let found = format!(
            "neutral pulse after {:.0} ms; the wheels slow down {:.0} ms later, from {:.2} m/s",
            pulse_s * 1e3,
            slower_s * 1e3,
            self.speed
        );
        let fix = "The daemon or the line is late: see docs/troubleshooting.md.";
        require(pulse_s <= within_s, &found, fix)?;
        require(slower_s <= ESC_WITHIN_S + self.blind_s, &found, ESC_HOLDS)?;
        let ends = [pulse_s - RECORD_S, pulse_s + RECORD_S].map(|end| (end * 1e3).max(0.0));
        let estimate = Interval::between(pulse_s * 1e3, ends);
        Ok(Finding::good(found).with(vec![Parameter::new(name, "ms", estimate)]))
    }
}

pub(super) fn silence(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stop = armed(bench, |car| stopped(car, |_| Ok(())))?;
    stop.finding("stop-silence", HOLD_S + PULSE_WITHIN_S)
}

pub(super) fn disarm(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stop = armed(bench, |car| stopped(car, Car::request_disarm))?;
    stop.finding("stop-disarm", PULSE_WITHIN_S)
}

pub(super) fn switch(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    if !bench.configuration().board.stop_input {
        let found = "board.stop_input is false: there is no stop switch";
        return Ok(Finding::new(Verdict::Skipped, found, ""));
    }
    let request = "The wheels will turn. Press the stop switch a second after they begin. Ready?";
    bench.ready("open-switch", request)?;
    let mut car = Car::look(bench)?;
    car.arm()?;
    let spun = spin_for_hand(&mut car, "press the stop switch")?;
    let first = car.board;
    let found = format!("the board did not notice a stop switch within {HAND_S:.0} s");
    let fix = "Check the switch and its wire (D4 to ground, normally closed): docs/uno.md.";
    require(car.is_latched(), found, fix)?;
    let mut readings: Vec<BoardReading> = first.into_iter().collect();
    // The time counts from the record with the mode: the hand gives no time stamp.
    let noticed = first.map_or(car.now, |reading| reading.receive);
    readings.extend(car.watch(WATCHED_S, "stopping")?);
    let stop = evaluate(&mut car, &readings, noticed, spun.last_speed());
    let request = "Release the stop switch and press the reset of the board. Done?";
    bench.ready("close-switch", request)?;
    stop.finding("stop-switch", PULSE_WITHIN_S)
}

pub(super) fn emergency(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut car = Car::look(bench)?;
    car.arm()?;
    let stop = stopped(&mut car, Car::request_emergency_stop)?;
    let found = "the board is not latched after an emergency stop";
    let fix = "Cut the supply of the ESC. See the log of the daemon.";
    require(car.is_latched(), found, fix)?;
    let request = "Press the reset of the board: the emergency stop is latched until then. Done?";
    bench.ready("clear-latch", request)?;
    // A bootloader may wait for longer than the operator.
    unlatched(bench)?;
    stop.finding("stop-emergency", PULSE_WITHIN_S)
}

/// Waits until the board has been reset and is configured again.
fn unlatched(bench: &mut dyn Bench) -> Result<(), Trouble> {
    const PATIENCE_S: f64 = 15.0;
    let mut car = Car::look(bench)?;
    let begin = car.now;
    while car.board.is_none() || car.is_latched() {
        let waited_s = car.now.seconds_since(begin);
        let fix = "Press the reset button of the board, and run this step again.";
        require(waited_s <= PATIENCE_S, "the board is still latched", fix)?;
        car.watch(0.1, "the board starts")?;
    }
    Ok(())
}

/// Turns the motor until a hand stops it.
fn spin_for_hand(car: &mut Car<'_>, what: &str) -> Result<Spun, Trouble> {
    let from_us = car.beyond_deadband();
    car.spin_for_hand(from_us, HAND_S, what)
}

pub(super) fn reset(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let request =
        "The wheels will turn. Press the reset of the board a second after they begin. Ready?";
    unheard(bench, "reset-at-speed", request)?;
    let seen = stopped_how(bench);
    // The board starts again, and the ESC with it where the board holds its supply.
    Car::wait_for_board(bench)?;
    by_eye(seen?, "the motor stopped at once, by eye", ESC_HOLDS)
}

/// The board tells afterwards whether it kept its power. Without it nobody gives a neutral pulse;
/// then the kill output has dropped the supply of the ESC (see the step `kill`), or the ESC
/// decides alone.
pub(super) fn unplug(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let request =
        "The wheels will turn. Pull the USB cable of the board a second after they begin. Ready?";
    let before = unheard(bench, "unplug", request)?;
    bench.ready("plug-in", "Plug the USB cable in again. Done?")?;
    Car::wait_for_board(bench)?;
    let mut car = Car::look(bench)?;
    car.watch(0.5, "the board reports")?;
    if kept_power(before, &car)? {
        let found =
            "the board has a supply of its own: it gives the neutral pulse without the cable";
        return Ok(Finding::good(found));
    }
    if bench.configuration().board.kill_output {
        let found = "the cable takes the board's power along, and the kill output that of the ESC";
        return Ok(Finding::good(found));
    }
    let seen = stopped_how(bench)?;
    let found =
        "the cable takes the board's power along: the ESC stopped by itself at once, by eye";
    by_eye(seen, found, OWN_SUPPLY)
}

/// Whether the board had power since `before`: its clock went on, or its restart was none of
/// power. (Opening the port resets an UNO.)
fn kept_power(before: Option<BoardReading>, car: &Car<'_>) -> Result<bool, Trouble> {
    let (Some(before), Some(now), Some(status)) = (before, car.board, car.status) else {
        let found = "the board does not report how it was reset";
        return Err(failed(found, CHECK_LINE));
    };
    let passed_s = now.receive.seconds_since(before.receive);
    let counted_s = f64::from(now.board_us.wrapping_sub(before.board_us)) * 1e-6;
    let goes_on = (counted_s - passed_s).abs() < 0.1 + 0.02 * passed_s;
    Ok(goes_on || ![ResetCause::PowerOn, ResetCause::BrownOut].contains(&status.reset_cause))
}

/// A stop after which the board sends nothing; returns the last telemetry before.
fn unheard(
    bench: &mut dyn Bench,
    id: &'static str,
    request: &'static str,
) -> Result<Option<BoardReading>, Trouble> {
    bench.ready(id, request)?;
    let mut car = Car::look(bench)?;
    car.arm()?;
    let spun = spin_for_hand(&mut car, "now, by hand")?;
    let found = format!("the board went on for {HAND_S:.0} s: nothing was done by hand");
    require(spun.ended.is_some(), found, "Run the bring-up again.")?;
    // The operator watches the wheels.
    let before = car.board;
    car.watch(2.0, "stopping")?;
    Ok(before)
}

/// When the motor stopped driving, counted from the operator's own action, be the cable plugged in
/// again or not.
fn stopped_how(bench: &mut dyn Bench) -> Result<&'static str, Trouble> {
    let text = "Did the motor stop driving at once (the wheels may roll on), later (it drove on \
                for half a second or more), or not?";
    bench.ask_word("stopped-how", text, &["at-once", "late", "not"])
}

fn by_eye(seen: &str, at_once: &'static str, fix: &'static str) -> Result<Finding, Trouble> {
    match seen {
        "at-once" => Ok(Finding::good(at_once)),
        "late" => {
            let found = "the motor drove on for a while without pulses";
            Ok(Finding::warning(found, fix))
        }
        _ => {
            let fix = "Cut the supply of the ESC, and do not use it: it must stop without pulses.";
            Err(failed("the motor drove on without pulses", fix))
        }
    }
}
