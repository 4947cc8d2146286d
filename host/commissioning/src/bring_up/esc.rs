//! The ESC: the kill switch of its supply, its neutral, and what a pulse below neutral does.

use singletrack_control::Time;
use singletrack_protocol::JOG_LIMIT_US;

use super::{
    car::{CHECK_LINE, Car, armed},
    motor::{CREEPS, FROM_US, beyond, way},
};
use crate::{
    Bench, BoardReading, Finding, Interval, Jog, Parameter, Trouble,
    finding::{change, failed, keys, require},
};

/// Time for which an armed board holds neutral, s.
const ARMED_S: f64 = 1.0;

/// Time that the operator has to cut the supply, s. The board ends a jog after 10 s.
const CUT_WITHIN_S: f64 = 6.0;

pub(super) fn find_kill(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    if bench.configuration().board.kill_output {
        by_board(bench)
    } else {
        by_hand(bench)
    }
}

fn by_board(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    const WIRING: &str = "Check the wiring of the kill output (pin D7) and of its relay, which is \
                          normally open: docs/uno.md.";
    let dark = |bench: &mut dyn Bench| {
        let text = "The car is disarmed. Is the ESC off: no light, no sound?";
        bench.ask_yes("esc-dark", text)
    };
    let found = "the ESC has its supply although the kill output is off";
    require(dark(bench)?, found, WIRING)?;
    let power = armed(bench, |car| {
        let rest = car.rest();
        car.hold(rest, ARMED_S, "armed at neutral")?;
        Ok(car.status.is_some_and(|status| status.power_on))
    })?;
    let found = "the armed board does not hold its kill output";
    require(power, found, "Load the image again: `cargo uno`.")?;
    let text = "The car was armed until a moment ago. Was the ESC on during that time?";
    let woke = bench.ask_yes("esc-woke", text)?;
    require(woke, "the armed board does not switch the ESC on", WIRING)?;
    let found = "the ESC keeps its supply after the board was disarmed";
    require(dark(bench)?, found, WIRING)?;
    let found = "the ESC is on while the board is armed, and off before and after";
    Ok(Finding::good(found))
}

fn by_hand(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    const NONE: &str = "Wire the kill output (docs/uno.md) and set board.kill_output, or put a \
                        switch that you reach at any time into the supply of the ESC.";
    let text = "Can you cut the supply of the ESC without the board: a radio relay, a plug that \
                you reach with the wheels turning?";
    if !bench.ask_yes("kill-switch", text)? {
        let found = "nothing but the pulses on one wire stops the motor";
        return Ok(Finding::warning(found, NONE));
    }
    let request =
        "The wheels will turn. Cut the supply of the ESC a second after they begin. Ready?";
    bench.ready("cut-supply", request)?;
    let what = "cut the supply";
    let spun = armed(bench, |car| car.spin_for_hand(FROM_US, CUT_WITHIN_S, what))?;
    let request =
        "Switch the supply of the ESC on again, and wait until the ESC has started. Done?";
    bench.ready("restore-supply", request)?;
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
    let mut newest_first = readings.iter().rev();
    let begin = newest_first.find(|reading| reading.motor_speed.abs() >= 0.9 * speed);
    let ends = begin.zip(readings.last());
    ends.map_or(0.0, |(begin, end)| end.receive.seconds_since(begin.receive))
}

/// Most milliseconds of this step in which the board may refuse edges of the sensor.
const REFUSED: u16 = 2;

/// Watches for `SECONDS` in each order of switching on.
pub(super) fn find_neutral<const SECONDS: u32>(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let seconds = f64::from(SECONDS);
    let orders = if bench.configuration().board.kill_output {
        // The board starts the ESC: there is one order.
        let readings = armed(bench, |car| {
            watch_sensor(car, |car| car.hold(car.rest(), seconds, "armed at neutral"))
        })?;
        check_neutral(&readings, "after the board")?;
        check_still(bench)?;
        "the board starts the ESC"
    } else {
        let after = "Switch the ESC off. Press the reset of the board, wait for three seconds, \
                     switch the ESC on. Done?";
        let before = "Leave the ESC on, and press the reset of the board. Done?";
        for (id, request, order) in [
            ("esc-after-board", after, "after the board"),
            ("board-after-esc", before, "before the board"),
        ] {
            bench.ready(id, request)?;
            let mut car = Car::look(bench)?;
            let readings = watch_sensor(&mut car, |car| car.watch(seconds, "at neutral"))?;
            check_neutral(&readings, order)?;
            check_still(bench)?;
        }
        "ESC on before and after the board"
    };
    let found = format!("no motor pulse in {seconds:.0} s at neutral: {orders}");
    Ok(Finding::good(found))
}

/// Takes readings, and fails if the board refused edges of the sensor meanwhile.
fn watch_sensor(
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

fn check_neutral(readings: &[BoardReading], order: &str) -> Result<(), Trouble> {
    let last = readings.last();
    let last = last.ok_or_else(|| failed("the board sent no telemetry", CHECK_LINE))?;
    let esc_us = last.esc_us;
    let found = format!("the motor turned at {esc_us} us with the ESC switched on {order}");
    let fix = "Calibrate the neutral of the ESC to 1500 us as its manual says (most learn it with \
               the throttle at rest), or write its neutral to board.esc.neutral_us.";
    require(!readings.iter().any(BoardReading::turns), found, fix)
}

fn check_still(bench: &mut dyn Bench) -> Result<(), Trouble> {
    let text = "Did the driven wheels stand still all the time?";
    let is_still = bench.ask_yes("wheels-still", text)?;
    let found = "the wheels turned at neutral, and no motor pulse came";
    let fix = "Calibrate the neutral of the ESC as its manual says. Check the pulse sensor.";
    require(is_still, found, fix)
}

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
#[derive(Debug, Default)]
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

pub(super) fn find_kind(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let esc = bench.configuration().board.esc;
    let feed_forward = f64::from(bench.configuration().board.speed.feed_forward_us_per_m_s);
    let pulse_of = |speed: f64| {
        let offset_us = esc.deadband_us + (speed * feed_forward).round() as u16;
        beyond(esc.neutral_us, offset_us.min(JOG_LIMIT_US), false).max(esc.min_us)
    };
    let mut brake_us = beyond(esc.neutral_us, JOG_LIMIT_US, false).max(esc.min_us);
    let seen = armed(bench, |car| {
        let at_rest = at_rest(car, pulse_of(AT_REST))?;
        if at_rest.contains(&true) {
            brake_us = pulse_of(AT_SPEED);
        }
        at_speed(car, at_rest, brake_us)
    })?;
    let [first, second] = seen.at_rest.map(|turned| match turned {
        true => "turned the wheels",
        false => "did not turn them",
    });
    let at_speed = match (seen.turned_round, seen.brakes()) {
        (true, _) => "turned the wheels round",
        (false, true) => "braked",
        (false, false) => "did not brake",
    };
    let found = format!(
        "at rest the first pulse below neutral {first}, the second {second}; at speed it \
         {at_speed}: the wheels stood after {:.2} m, after {:.2} m at neutral",
        seen.braked_m, seen.rolled_m
    );
    let Some(kind) = seen.kind() else {
        let found = format!("{found}; no pulse below neutral had an effect");
        let fix = "None, if board.esc.kind is left out: no pulse below neutral is ever sent.";
        return Ok(Finding::warning(found, fix));
    };
    let mut kinds = ["car", "forward-reverse", "vesc"].into_iter();
    let number = kinds.position(|name| name == kind).unwrap_or(0);
    let number = Interval::around(number as f64, 0.0);
    let parameters = vec![Parameter::new("esc-kind", "", number).written("board.esc.kind", kind)];
    let mut values = keys(&parameters);
    if kind != "forward-reverse" {
        values.push(("board.esc.brake_us", i64::from(brake_us).into()));
    }
    change(bench, &values)?;
    let is_written = bench.configuration().board.esc.kind.is_some();
    let fix = "Write it by hand.";
    require(is_written, "board.esc.kind was not written", fix)?;
    Ok(Finding::good(format!("\"{kind}\": {found}")).with(parameters))
}

/// Whether the first and the second pulse below neutral turn wheels at rest.
fn at_rest(car: &mut Car<'_>, esc_us: u16) -> Result<[bool; 2], Trouble> {
    let rest = car.rest();
    let below = Jog { esc_us, ..rest };
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
fn at_speed(car: &mut Car<'_>, at_rest: [bool; 2], esc_us: u16) -> Result<Seen, Trouble> {
    let rest = car.rest();
    let brake = Jog { esc_us, ..rest };
    let mut seen = Seen {
        at_rest,
        ..Seen::default()
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
