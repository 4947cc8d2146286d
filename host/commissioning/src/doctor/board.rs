//! Board and supply: the board's own condition, a reset, the battery, the stop switch.

use singletrack_pilot::Reason;
use singletrack_protocol::{ResetCause, Status};

use super::gather::{Checks, PRESS_RESET};
use crate::{
    Answer, Answers, Bench, Finding, Interrupted, Question, Trouble,
    Verdict::{Failed, Good, Warning},
    observed::Readings,
};

/// A reset that takes longer leaves the ESC without pulses for too long: some keep their last
/// one for a second.
const SLOW_RESET_S: f64 = 3.5;
/// After a longer silence the board was not reset, or does not start.
const RESET_PATIENCE_S: f64 = 30.0;
/// The longest wait for a plug or a switch, in s.
const PLUG_PATIENCE_S: f64 = 45.0;
/// The supply below which the next load may reset the board, and below which it does.
const LOW_SUPPLY_MV: u16 = 4_700;
const BAD_SUPPLY_MV: u16 = 4_450;
/// The share by which the board's voltage may differ from a voltmeter's: the reference of the
/// processor differs by a few percent, see docs/uno.md.
const VOLTAGE_SHARE: f64 = 0.05;

/// Whether the board answers, with which reset cause, and how long a reset takes.
pub(super) fn image(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let readings = checks.for_time(1.5, "board")?;
    if let Some((found, fix)) = refusal(&readings) {
        let expected = "the board's image and configuration are accepted";
        return Err(checks.fail(found, expected, fix));
    }
    let Some(status) = readings.status() else {
        let expected = "telemetry 100 times a second";
        let fix = "connect the board, look at serial.port, and flash the image: cargo uno";
        return Err(checks.fail("the board is silent", expected, fix));
    };
    let rate = readings.boards.len() as f64 / readings.duration().max(0.1);
    let found = format!("telemetry {rate:.0} times a second");
    let fix = "look for a noisy or slow line: serial.baud, cable, hub";
    checks.check(rate > 80.0, found, "100", fix);
    check_line(&readings, &mut checks);
    check_reset_cause(status.reset_cause, &mut checks);
    reset(&mut checks)?;
    checks.finding()
}

/// Why the daemon does not accept the board, and what to do.
fn refusal(readings: &Readings) -> Option<(&'static str, &'static str)> {
    match readings.ticks.last()?.preflight? {
        Reason::VersionDiffers => Some((
            "the image on the board is of another protocol version",
            "flash the image of this release: cargo uno --flash",
        )),
        Reason::ConfigurationRefused => Some((
            "the board refuses the configuration",
            "compare board.car_id with the number that the image was built with; \
             singletrack status says what was refused",
        )),
        _ => None,
    }
}

fn check_line(readings: &Readings, checks: &mut Checks<'_>) {
    let damaged = readings.risen(|status| status.frames_damaged);
    let overrun = readings.risen(|status| status.bytes_overrun);
    let found = format!("{damaged} frames damaged, {overrun} bytes lost");
    let fix = "use a short USB cable, away from the motor's wires";
    checks.check(damaged <= 1 && overrun == 0, found, "none", fix);
}

fn check_reset_cause(cause: ResetCause, checks: &mut Checks<'_>) {
    let found = format!("last reset: {}", cause.name());
    let (verdict, fix) = match cause {
        ResetCause::PowerOn | ResetCause::External => (Good, ""),
        ResetCause::BrownOut => (
            Warning,
            "the 5 V have dipped: give the servo a supply of its own",
        ),
        ResetCause::Watchdog => (Warning, "report it: the image has hung"),
        ResetCause::Unknown => (
            Warning,
            "the bootloader hides the cause: flash the one of docs/uno.md",
        ),
    };
    checks.add(verdict, found, "power-on or external", fix);
}

/// The time without telemetry after the button.
fn reset(checks: &mut Checks<'_>) -> Result<(), Interrupted> {
    if checks.skips("reset", "press-reset", PRESS_RESET)? {
        return Ok(());
    }
    let (readings, is_done) = checks.until(|readings| {
        let silence = readings.longest_silence();
        let since = silent_since(readings);
        let is_back = silence > 0.2 && since < 0.1 && readings.links.last() != Some(&false);
        let gives_up = readings.duration() > RESET_PATIENCE_S;
        let text = format!("silent for {:.1} s", silence.max(since));
        (text, f64::from(u8::from(is_back || gives_up)))
    })?;
    let silence = readings.longest_silence();
    let found = format!("a reset takes {silence:.1} s");
    let expected = format!("at most {SLOW_RESET_S} s");
    if silence < 0.2 || !is_done || readings.duration() > RESET_PATIENCE_S {
        let fix = "press the button of the board itself; if it was pressed, the board does not \
                   start again: flash the image";
        checks.add(Failed, "no reset was seen", expected, fix);
    } else {
        let fix = "the bootloader waits: the ESC has no pulses meanwhile; see docs/uno.md";
        let verdict = Warning.unless(silence <= SLOW_RESET_S);
        checks.add(verdict, found, expected, fix);
    }
    Ok(())
}

/// Time since the last telemetry, in s.
fn silent_since(readings: &Readings) -> f64 {
    let heard = readings.boards.last().map(|board| board.receive);
    let since = heard.or(readings.ticks.first().map(|tick| tick.time));
    let ends = since.zip(readings.ticks.last());
    ends.map_or(0.0, |(since, now)| now.time.seconds_since(since).max(0.0))
}

/// Battery, supply and stop switch.
pub(super) fn power(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let readings = checks.for_time(1.0, "supply")?;
    let Some(status) = readings.status() else {
        let expected = "a status five times a second";
        return Err(checks.fail("the board is silent", expected, "see step board"));
    };
    if checks.config().supervisor.arm_battery_v > 0.0 {
        battery(&status, &mut checks)?;
    } else {
        let found = "the battery is not watched";
        let fix = "wire it as in docs/uno.md and set supervisor.arm_battery_v";
        checks.add(Warning, found, "a voltage divider on A0", fix);
    }
    if checks.config().board.stop_input {
        stop_switch(&mut checks)?;
    } else {
        let found = "no stop switch is configured";
        let fix = "wire one as in docs/uno.md and set board.stop_input = true";
        checks.add(Warning, found, "a normally-closed switch", fix);
    }
    supply(&mut checks)?;
    checks.finding()
}

fn battery(status: &Status, checks: &mut Checks<'_>) -> Result<(), Interrupted> {
    let supervisor = &checks.config().supervisor;
    let (wanted, minimum) = (supervisor.arm_battery_v, supervisor.min_battery_v);
    let volts = f64::from(status.battery_mv) * 1e-3;
    if status.battery_open {
        let found = "nothing is connected to A0";
        let fix = "wire it as in docs/uno.md";
        checks.add(Failed, found, "the battery's divider", fix);
        return Ok(());
    }
    let found = format!("battery {volts:.2} V");
    let expected = format!("at least {wanted:.1} V to arm");
    let fix = "charge the battery, or set supervisor.arm_battery_v for its cells";
    checks.check(volts >= wanted, found, expected, fix);
    let voltmeter = Question {
        id: "voltmeter",
        text: "Measure the battery with a voltmeter. Its voltage?".into(),
        answers: Answers::Number {
            unit: "V",
            range: [0.0, 60.0],
        },
    };
    match checks.bench.ask(&voltmeter)? {
        Answer::Number(meter) => {
            let share = (volts - meter).abs() / meter.max(1.0);
            let found = format!("the voltmeter shows {meter:.2} V");
            let expected = format!("the same within {:.0} %", 100.0 * VOLTAGE_SHARE);
            let fix = "look at the two resistors of the divider: they must be equal, see \
                       docs/uno.md";
            checks.check(share <= VOLTAGE_SHARE, found, expected, fix);
        }
        _ => checks.skipped("voltmeter"),
    }
    let request = "Press Enter, then unplug the battery. The board stays on USB.";
    if checks.skips("unplugged battery", "unplug-battery", request)? {
        return Ok(());
    }
    let is_gone =
        |status: &Status| status.battery_open || f64::from(status.battery_mv) * 1e-3 < minimum;
    let noticed = seen(checks, "battery", is_gone)?;
    let not = if noticed { "" } else { "not " };
    let found = format!("an unplugged battery is {not}noticed");
    let fix = "A0 is fed from somewhere else: wire the divider to the battery's plug";
    checks.check(noticed, found, "noticed", fix);
    let request = "Press Enter, then plug the battery in again.";
    let question = Question::begin("plug-battery", request);
    if checks.bench.ask(&question)? != Answer::Skip {
        let is_back = seen(checks, "battery", |status| !is_gone(status))?;
        let found = "battery plugged in";
        checks.check(is_back, found, "plugged in", "plug it in again");
    }
    Ok(())
}

fn stop_switch(checks: &mut Checks<'_>) -> Result<(), Interrupted> {
    let open = "Press Enter, then open the stop switch (press the red button).";
    let close = "Press Enter, then close the stop switch again.";
    for (id, request, is_open, word) in [
        ("open-stop-switch", open, true, "open"),
        ("close-stop-switch", close, false, "closed"),
    ] {
        if checks.skips("stop switch", id, request)? {
            return Ok(());
        }
        let has_moved = |status: &Status| status.stop_input_open == is_open;
        let was_seen = seen(checks, "stop switch", has_moved)?;
        let how = if was_seen { "seen" } else { "not seen" };
        let found = format!("stop switch {word}: {how}");
        let fix = "wire the switch as in docs/uno.md: normally closed, between its pin and ground";
        checks.check(was_seen, found, "seen", fix);
    }
    // An open switch stops the board until its reset.
    if !checks.reset_if_stopped()? {
        let found = "the board is stopped by the switch";
        let expected = "reset after the check";
        let fix = "press the reset button of the board";
        checks.add(Failed, found, expected, fix);
    }
    Ok(())
}

fn supply(checks: &mut Checks<'_>) -> Result<(), Interrupted> {
    let request = "Press Enter, then push the front wheels to the left and to the right by hand, \
                   against the servo, for five seconds. Do not force them.";
    if checks.skips("supply under load", "push-wheels", request)? {
        return Ok(());
    }
    let readings = checks.for_time(5.0, "supply")?;
    let health = readings.health.iter();
    let lowest = health.map(|health| health.status.supply_mv).min();
    let lowest = lowest.unwrap_or(0);
    let found = format!("supply at least {:.2} V", f64::from(lowest) * 1e-3);
    let expected = format!("{:.1} V", f64::from(LOW_SUPPLY_MV) * 1e-3);
    let fix = "feed the servo from the ESC's BEC or from a supply of its own, not from the board";
    let verdict = match lowest {
        LOW_SUPPLY_MV.. => Good,
        BAD_SUPPLY_MV.. => Warning,
        _ => Failed,
    };
    checks.add(verdict, found, expected, fix);
    Ok(())
}

/// Whether a status with a property comes within the doctor's patience.
fn seen(
    checks: &mut Checks<'_>,
    what: &str,
    property: impl Fn(&Status) -> bool,
) -> Result<bool, Interrupted> {
    let mut was_seen = false;
    checks.until(|readings| {
        // The first ones may have been on their way before the answer.
        let mut later = readings.health.iter().skip(1);
        was_seen = later.any(|health| property(&health.status));
        let waited = readings.duration();
        let share = (waited / PLUG_PATIENCE_S).min(1.0);
        let text = format!("{what}: {:.0} s", PLUG_PATIENCE_S - waited);
        (text, if was_seen { 1.0 } else { share })
    })?;
    Ok(was_seen)
}
