//! The motor: how it is turned in an armed jog; direction, deadband on both sides of neutral,
//! feed-forward.
//!
//! The deadband is that of `board.esc.deadband_us`: the band of pulses in which the wheels
//! stand, with what the ESC ignores and what the drive train holds. Its edges come from the
//! speeds beyond it: close to the edge the pulses are too rare to distinguish a wheel that
//! creeps from one that stands.

use singletrack_control::{Time, student_quantile};
use singletrack_protocol::{JOG_LIMIT_US, StopCause};

use super::car::{Car, armed};
use crate::{
    Bench, BoardReading, Finding, Interval, Jog, Parameter, Trouble,
    finding::{change, failed, keys},
    fit::{
        LeastSquares,
        drive_train::{SpeedCurve, fit_speed_curve},
        least_squares, mean, standard_deviation,
    },
};

/// Speed of the wheels in most steps, m/s: it comes to about 0.5.
pub(super) const SPIN_M_S: f64 = 0.4;

/// Speed below which wheels that slow down count as standing, m/s.
pub(super) const CREEPS: f64 = 0.12;

/// Where the search for the first turn begins, beyond neutral, us.
pub(super) const FROM_US: u16 = 16;

/// Time in which a speed settles, and time in which it is measured, s.
const SETTLE_S: f64 = 0.7;
const MEASURE_S: f64 = 0.6;

/// Speeds that are measured, m/s. The board ends a jog beyond 1.0.
const SLOWEST: f64 = 0.06;
const FASTEST: f64 = 0.75;
/// Wanted change of the speed from one level to the next, m/s.
const STEP: f64 = 0.09;

/// Step of the search for the slowest speed, us.
const SLOWER_US: u16 = 4;

/// Slope of speed over pulse that is assumed before it is known.
const STEEPEST_M_S_PER_US: f64 = 0.016;

/// The longest time between two pulses of a motor that turns slowly, s.
const PULSE_WITHIN_S: f64 = 0.35;

/// Most levels on one way.
const MOST_LEVELS: usize = 24;

/// Time for which the motor is driven without a rest, s. The board allows 10.
const DRIVEN_S: f64 = 5.0;

/// Bound on the difference between the standing band and its curve, us: the first turn needs
/// more than the last one.
const BREAKAWAY_US: f64 = 1.0;

/// The speed for which the feed-forward is given, m/s.
const AT_SPEED: f64 = 0.5;

/// Change of the feed-forward with the charge of the battery.
const CHARGE: f64 = 0.06;

/// Mean width that friction in the drive train adds to the band that the ESC ignores, us; the
/// true one is between zero and twice this. It counts where the other edge is that of the ESC
/// alone.
const HELD_US: f64 = 5.0;

/// Bound on the distance of the band's middle from a configured neutral at which the wheels
/// stand, us.
const NEUTRAL_US: f64 = 20.0;

/// Bound on the error of a brake's edge besides its scatter, us: an ESC does not begin to brake
/// at one exact pulse.
const BRAKE_US: f64 = 6.0;

/// Fits with residuals up to this multiple of the least ones count as equally good.
const NEARLY: f64 = 1.5;

/// Times from a pulse until it acts and shows, s: its frame, the ESC, the telemetry.
const LATE_S: [f64; 7] = [0.03, 0.045, 0.06, 0.075, 0.09, 0.105, 0.12];

/// The widest band that an ESC ignores, to one side, us.
const WIDEST_US: f64 = 60.0;

pub(super) fn direction(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let turned = armed(bench, |car| {
        let Some(jog) = car.spin_from(FROM_US, SPIN_M_S)? else {
            return Ok(None);
        };
        // For the operator to see.
        car.hold(jog, 1.0, "which way do the wheels turn?")?;
        Ok(Some(jog.esc_us))
    });
    let turned = match turned {
        // The motor may turn while its sensor does not count.
        Err(Trouble::Ended {
            cause: StopCause::MotorSensor,
            ..
        }) => None,
        turned => turned?,
    };
    let text = "How did the driven wheels turn just now: as for driving forward, or backward?";
    let ways = &["forward", "backward", "stood"];
    let seen = bench.ask_word("driven-wheels", text, ways)?;
    let (found, fix) = match (turned, seen) {
        (Some(pulse_us), "forward") => {
            let found = format!("forward at {pulse_us} us, and the pulses count");
            return Ok(Finding::good(found));
        }
        (Some(_), "backward") => (
            "a pulse above neutral drives backward",
            "Swap two of the motor's wires (brushless: any two; brushed: both), or reverse the \
             direction in the settings of the ESC.",
        ),
        (Some(_), _) => (
            "motor pulses came, and the driven wheels did not turn",
            "Does the drive train slip? Is D2 connected to the motor's sensor, and no other wire?",
        ),
        (None, "stood") => return Err(never_turned()),
        (None, _) => (
            "the wheels turned, and no motor pulse came",
            "Check the pulse sensor on D2: magnet, distance, supply.",
        ),
    };
    Err(failed(found, fix))
}

pub(super) fn map(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let (ahead, reverse, brake) = armed(bench, |car| {
        let ahead = curve(car, true)?.ok_or_else(never_turned)?;
        let reverse = curve(car, false)?;
        let brake = match reverse {
            Some(_) => None,
            None => brake_edge(car, &ahead)?,
        };
        Ok((ahead, reverse, brake))
    })?;
    let configured = f64::from(bench.configuration().board.esc.neutral_us);
    let upper = ahead.edge;
    // Both relative to the configured neutral.
    let (neutral, deadband, how) = match (reverse, brake) {
        (Some(curve), _) => {
            let half = upper.half_width().hypot(curve.edge.half_width()) / 2.0;
            let lower = -curve.edge.value;
            let neutral = Interval::around(f64::midpoint(upper.value, lower), half);
            let deadband = Interval::around((upper.value - lower) / 2.0, half);
            (neutral, deadband, "turns both ways")
        }
        (None, Some(edge)) => {
            // The ESC's own edge: on the other side the drive train holds a little more.
            let half = upper.half_width().hypot(edge.half_width()) / 2.0;
            let middle = f64::midpoint(upper.value - HELD_US, -edge.value);
            let neutral = Interval::around(middle, half).widened(HELD_US / 2.0);
            // The wheels stood at the configured neutral, so it lies within the band.
            let neutral = with_prior(neutral, NEUTRAL_US);
            let deadband = neutral.scaled(-1.0).shifted(upper.value);
            (neutral, deadband, "turns forward, brakes below neutral")
        }
        (None, None) => {
            let ends = [(upper.low - WIDEST_US).min(0.0), upper.high.max(0.0)];
            let neutral = Interval::between(0.0, ends);
            let deadband = Interval::between(upper.value, [0.0, WIDEST_US.max(upper.high)]);
            (neutral, deadband, "turns forward only")
        }
    };
    let neutral = neutral.shifted(configured);
    let neutral_us = neutral.value.round();
    // Rounded so that the band stays between both edges.
    let band = (upper.value - (neutral_us - configured))
        .min(deadband.value + (deadband.value - 0.5).clamp(0.0, 0.5))
        .floor()
        .clamp(0.0, 200.0);
    if (neutral_us - 1_500.0).abs() > band {
        let found = format!(
            "the wheels stand from {:.0} to {:.0} us: not at 1500 us, which the board gives \
             before it is configured",
            neutral.value - deadband.value,
            neutral.value + deadband.value
        );
        let fix = "Calibrate the neutral of the ESC to 1500 us as its manual says.";
        return Err(failed(found, fix));
    }
    let feed_forward = ahead
        .feed_forward
        .widened(CHARGE * ahead.feed_forward.value);
    let feed_forward_us = feed_forward.value.round().clamp(0.0, 5_000.0);
    let parameters = vec![
        Parameter::new("esc-neutral", "us", neutral)
            .written("board.esc.neutral_us", neutral_us as i64),
        Parameter::new("esc-deadband", "us", deadband)
            .written("board.esc.deadband_us", band as i64),
        Parameter::new("feed-forward", "us/(m/s)", feed_forward).written(
            "board.speed.feed_forward_us_per_m_s",
            feed_forward_us as i64,
        ),
    ];
    change(bench, &keys(&parameters))?;
    let found = format!(
        "{how}: neutral {:.1} us (known to {:.1}), deadband {:.1} us (known to {:.1}), {:.0} us per m/s at \
         {AT_SPEED} m/s; the speeds are within {:.1} us of their curve",
        neutral.value,
        neutral.half_width(),
        deadband.value,
        deadband.half_width(),
        feed_forward.value,
        ahead.scatter
    );
    let fix = "The speed is not steady at a steady pulse: does the drive train drag, or D2 pick up \
               interference?";
    Ok(Finding::warning_if(ahead.scatter > 4.0, found, fix).with(parameters))
}

/// With a value of zero that is known before to ±`bound` in 95 of 100 cases.
fn with_prior(measured: Interval, bound: f64) -> Interval {
    let weight = measured.half_width().powi(-2);
    let sum = weight + bound.powi(-2);
    Interval::around(measured.value * weight / sum, sum.sqrt().recip())
}

/// The settled speeds on one side of neutral; nothing if the wheels do not turn there.
fn curve(car: &mut Car<'_>, forward: bool) -> Result<Option<SpeedCurve>, Trouble> {
    let Some(first) = car.first_turn(forward, FROM_US)? else {
        return Ok(None);
    };
    let levels = levels(car, forward, first)?;
    let curve = fit_speed_curve(&levels, BREAKAWAY_US, AT_SPEED).ok_or_else(|| {
        let count = levels.len();
        let found = format!("{count} settled speeds give no curve of speed over pulse");
        let fix = "The motor turns too fast or too unsteadily within 150 us of neutral: reduce the \
                   power in the settings of the ESC, and check the pulse sensor.";
        failed(found, fix)
    })?;
    Ok(Some(curve))
}

/// Pulses beyond neutral and their settled speeds, up and down again.
fn levels(car: &mut Car<'_>, forward: bool, first: Jog) -> Result<Vec<[f64; 2]>, Trouble> {
    let rest = car.rest();
    let begin_us = rest.esc_us.abs_diff(first.esc_us);
    let mut since = car.now;
    let mut levels: Vec<[f64; 2]> = Vec::new();
    // The first turn may be well beyond the edge: the pulses are far apart, or the step large.
    // The board ends a jog without a pulse for 0.6 s.
    let pulse_m = f64::from(car.bench().configuration().board.speed.pulse_distance_um) * 1e-6;
    let slowest = SLOWEST.max(pulse_m / PULSE_WITHIN_S);
    let mut slowest_us = begin_us;
    let mut drop = STEEPEST_M_S_PER_US * f64::from(SLOWER_US);
    loop {
        let before = levels.last().map(|[_, speed]| *speed);
        let speed = settled(car, &mut since, forward, slowest_us, &mut levels)?;
        drop = before.map_or(drop, |before| before - speed);
        if speed - drop < slowest || slowest_us < SLOWER_US + 4 {
            break;
        }
        slowest_us -= SLOWER_US;
    }
    let mut offset_us = begin_us + SLOWER_US;
    let mut last: Option<(u16, f64)> = levels.first().map(|[_, speed]| (begin_us, *speed));
    let mut way_up = vec![begin_us];
    while offset_us <= JOG_LIMIT_US && way_up.len() < MOST_LEVELS {
        let speed = settled(car, &mut since, forward, offset_us, &mut levels)?;
        if speed >= SLOWEST {
            way_up.push(offset_us);
        }
        if speed >= FASTEST {
            break;
        }
        let step_us = match last {
            Some((before_us, before)) if speed > before => {
                let per_us = (speed - before) / f64::from(offset_us - before_us);
                (STEP.min(0.9 - speed) / per_us).floor().clamp(2.0, 14.0) as u16
            }
            _ => SLOWER_US,
        };
        last = Some((offset_us, speed));
        offset_us += step_us;
    }
    for offset_us in way_up.into_iter().rev() {
        settled(car, &mut since, forward, offset_us, &mut levels)?;
    }
    car.hold_until_standing(rest, 0.8)?;
    Ok(levels)
}

/// The settled speed at this pulse, m/s, after a rest if the motor has been driven for long. It is one
/// of the levels, if the wheels turn well.
fn settled(
    car: &mut Car<'_>,
    since: &mut Time,
    forward: bool,
    offset_us: u16,
    levels: &mut Vec<[f64; 2]>,
) -> Result<f64, Trouble> {
    let rest = car.rest();
    if car.now.seconds_since(*since) > DRIVEN_S - SETTLE_S - MEASURE_S {
        car.hold_until_standing(rest, 0.8)?;
        *since = car.now;
    }
    let esc_us = beyond(rest.esc_us, offset_us, forward);
    let jog = Jog { esc_us, ..rest };
    car.hold(jog, SETTLE_S, "settling")?;
    let speed = mean_speed(&car.hold(jog, MEASURE_S, "measuring")?);
    if speed >= SLOWEST {
        levels.push([offset_us.into(), speed]);
    }
    Ok(speed)
}

/// Pulse below neutral beyond which a turning motor is braked, us, from how much harder it
/// slows down the farther below neutral the pulse is.
fn brake_edge(car: &mut Car<'_>, ahead: &SpeedCurve) -> Result<Option<Interval>, Trouble> {
    /// Pulses below neutral, us. A steady brake grows with them.
    const PULSES_US: [u16; 8] = [35, 50, 65, 80, 95, 110, 125, 140];
    let ahead_us = ahead.pulse(FASTEST).round().clamp(0.0, 150.0) as u16;
    let mut free = Vec::new();
    let mut braked = Vec::new();
    for _ in 0..2 {
        free.extend(slows_down(car, ahead_us, 0)?);
        for offset_us in PULSES_US {
            let slowing = slows_down(car, ahead_us, offset_us)?;
            braked.extend(slowing.map(|slowing| (slowing, f64::from(offset_us))));
        }
        free.extend(slows_down(car, ahead_us, 0)?);
    }
    // The brake grows linearly with the pulse. With a wrong lateness the readings lie on a
    // curve.
    let fits: Vec<_> = LATE_S
        .into_iter()
        .filter_map(|late_s| edge_if_late(&free, &braked, late_s))
        .collect();
    let best = fits.iter().min_by(|a, b| a.residual.total_cmp(&b.residual));
    Ok(best.and_then(|best| {
        let freedom = best.count.checked_sub(3).filter(|freedom| *freedom >= 3)?;
        let half = student_quantile(freedom) * best.standard_errors[0];
        let edge = best.parameters[0];
        // The readings do not distinguish these latenesses.
        let late = fits
            .iter()
            .filter(|fit| fit.residual < NEARLY * best.residual)
            .map(|fit| (fit.parameters[0] - edge).abs())
            .fold(0.0, f64::max);
        Some(Interval::around(edge, half).widened(BRAKE_US.hypot(late)))
    }))
}

/// Where the brake begins if its effect shows after `late_s`: a line of pulses below neutral
/// over the deceleration beyond that of rolling, m/s².
fn edge_if_late(
    free: &[Slowing],
    braked: &[(Slowing, f64)],
    late_s: f64,
) -> Option<LeastSquares<2>> {
    let free: Vec<f64> = free
        .iter()
        .filter_map(|slowing| slowing.deceleration(late_s))
        .collect();
    let (rolling, scatter) = (mean(&free)?, standard_deviation(&free)?);
    let rows: Vec<_> = braked
        .iter()
        .filter_map(|(slowing, at)| {
            let more = slowing.deceleration(late_s)? - rolling;
            // A difference within the scatter of rolling is no brake.
            (more > 0.15 * rolling + 3.0 * scatter).then_some(([1.0, more], *at))
        })
        .collect();
    // A fit of a few readings has small residuals and means nothing.
    let enough = 2 * rows.len() >= braked.len();
    least_squares(rows.iter().copied()).filter(|fit| enough && fit.parameters[1] > 0.0)
}

/// Wheels that slowed down.
#[derive(Clone, Copy, Debug)]
struct Slowing {
    speed: f64,
    way: f64,
}

impl Slowing {
    /// Deceleration by the way, less what the wheels turned before the pulse acted.
    fn deceleration(&self, late_s: f64) -> Option<f64> {
        let way = self.way - self.speed * late_s;
        let squares = self.speed.powi(2) - CREEPS.powi(2);
        (squares > 0.0 && way > 0.1 * self.way).then(|| squares / (2.0 * way))
    }
}

/// Turns the motor, then gives this pulse below neutral.
fn slows_down(
    car: &mut Car<'_>,
    ahead_us: u16,
    offset_us: u16,
) -> Result<Option<Slowing>, Trouble> {
    let rest = car.rest();
    car.hold_until_standing(rest, 0.8)?;
    let esc_us = beyond(rest.esc_us, ahead_us, true);
    let readings = car.hold(Jog { esc_us, ..rest }, 1.2, "turning")?;
    let speed = mean_speed(&readings[readings.len() / 2..]);
    let esc_us = beyond(rest.esc_us, offset_us, false);
    let slow = Jog { esc_us, ..rest };
    // Wheels that stand at once must not look like a dead sensor to the board.
    let mut all = car.hold(slow, 0.5, "slowing down")?;
    if all.last().is_some_and(BoardReading::turns) {
        all.extend(car.hold_until(rest, 4.0, "slowing down", |reading| !reading.turns())?);
    }
    let way = way(&all);
    Ok((speed > 0.2).then_some(Slowing { speed, way }))
}

impl Car<'_> {
    /// Turns the motor forward, beginning just beyond its deadband, at this speed of its wheels at
    /// least if 150 us reach it; gives the pulse.
    pub(super) fn spin(&mut self, wanted: f64) -> Result<Jog, Trouble> {
        let from_us = self.beyond_deadband();
        self.spin_from(from_us, wanted)?.ok_or_else(never_turned)
    }

    /// Where the search for the first turn begins once the deadband is known, beyond neutral, us.
    pub(super) fn beyond_deadband(&mut self) -> u16 {
        self.bench().configuration().board.esc.deadband_us + 4
    }

    /// [`Self::spin`] that begins `from_us` beyond neutral; nothing if the motor does not turn.
    ///
    /// The ESC is driven in bursts until the first pulses come: after 0.6 s of driving without a
    /// pulse the board assumes a dead sensor.
    fn spin_from(&mut self, from_us: u16, wanted: f64) -> Result<Option<Jog>, Trouble> {
        let Some(mut jog) = self.first_turn(true, from_us)? else {
            return Ok(None);
        };
        let highest = jog.esc_us.max(self.rest().esc_us + JOG_LIMIT_US);
        let begin = self.now;
        let mut before = 0.0;
        loop {
            let readings = self.hold(jog, 0.4, "spinning up")?;
            let speed = mean_speed(&readings[readings.len() / 2..]);
            let late = self.now.seconds_since(begin) > 5.0;
            if speed >= wanted || late || jog.esc_us >= highest {
                return Ok(Some(jog));
            }
            // Smaller steps where the last one raised the speed by more than 0.15 m/s.
            let step_us = if speed - before > 0.15 { 3 } else { 8 };
            before = speed;
            jog.esc_us = (jog.esc_us + step_us).min(highest);
        }
    }

    /// Turns the motor until the jog ends, the wheels stand, or the time is over. A hand may stop it
    /// as soon as the wheels turn.
    pub(super) fn spin_for_hand(
        &mut self,
        from_us: u16,
        seconds: f64,
        what: &str,
    ) -> Result<Spun, Trouble> {
        let mut jog = self.first_turn(true, from_us)?.ok_or_else(never_turned)?;
        let highest = self.rest().esc_us + JOG_LIMIT_US;
        let begin = self.now;
        let mut spun = Spun::default();
        while self.now.seconds_since(begin) < seconds {
            let held = self.hold_until(jog, 0.1, what, |reading| !reading.turns());
            match held {
                Ok(readings) => spun.readings.extend(readings),
                Err(Trouble::Ended { cause, .. }) => {
                    spun.ended = Some(cause);
                    break;
                }
                Err(trouble) => return Err(trouble),
            }
            let Some(last) = spun.readings.last().map(|last| last.motor_speed.abs()) else {
                continue;
            };
            if last == 0.0 {
                break;
            }
            // Not while the hand slows it down.
            if last < 0.4 && last >= 0.9 * spun.fastest() {
                jog.esc_us = (jog.esc_us + 4).min(highest);
            }
        }
        Ok(spun)
    }

    /// Drives in bursts of 0.5 s, each 8 us farther from neutral, until the wheels turn; gives
    /// that pulse, which is still held.
    fn first_turn(&mut self, forward: bool, from_us: u16) -> Result<Option<Jog>, Trouble> {
        let rest = self.rest();
        let mut offset_us = from_us.min(JOG_LIMIT_US);
        loop {
            // The board forgets the burst before after 0.6 s, and a car's ESC takes a second
            // pulse below neutral for reverse.
            self.hold_until_standing(rest, 0.7)?;
            let esc_us = beyond(rest.esc_us, offset_us, forward);
            let jog = Jog { esc_us, ..rest };
            let what = "looking for the first turn";
            let readings = self.hold_until(jog, 0.5, what, BoardReading::turns)?;
            if readings.iter().any(BoardReading::turns) {
                return Ok(Some(jog));
            }
            if offset_us >= JOG_LIMIT_US {
                self.hold(rest, 0.1, "neutral")?;
                return Ok(None);
            }
            offset_us = (offset_us + 8).min(JOG_LIMIT_US);
        }
    }

    /// Holds these pulses for a time at least, and until the wheels stand, 8 s at most.
    pub(super) fn hold_until_standing(&mut self, jog: Jog, seconds: f64) -> Result<(), Trouble> {
        self.hold(jog, seconds, "neutral")?;
        if self.board.is_some_and(|board| board.turns()) {
            self.hold_until(jog, 8.0, "rolling out", |reading| !reading.turns())?;
            // The reported speed is zero half a second after the last pulse. Where pulses are far
            // apart, the board needs longer to take the wheels for standing.
            self.hold(jog, 0.3, "neutral")?;
        }
        Ok(())
    }
}

/// A motor that was turned until a hand stopped it.
#[derive(Debug, Default)]
pub(super) struct Spun {
    /// The telemetry until then.
    pub(super) readings: Vec<BoardReading>,
    /// The board's reason, if the jog ended.
    pub(super) ended: Option<StopCause>,
}

impl Spun {
    /// Highest speed, m/s.
    pub(super) fn fastest(&self) -> f64 {
        let readings = self.readings.iter();
        let speeds = readings.map(|reading| reading.motor_speed.abs());
        speeds.fold(0.0, f64::max)
    }

    /// Speed before the end, m/s.
    pub(super) fn last_speed(&self) -> f64 {
        let from = self.readings.len().saturating_sub(20);
        mean_speed(&self.readings[from..])
    }

    /// Whether the wheels came to rest while their pulse still drove them.
    pub(super) fn stopped_under_drive(&self) -> bool {
        let stands = self.readings.last().is_some_and(|last| !last.turns());
        // The board can't distinguish a motor that does not turn from a dead sensor.
        stands || self.ended == Some(StopCause::MotorSensor)
    }
}

/// The pulse at this distance from neutral.
pub(super) fn beyond(neutral_us: u16, offset_us: u16, forward: bool) -> u16 {
    if forward {
        neutral_us + offset_us
    } else {
        neutral_us.saturating_sub(offset_us)
    }
}

/// Mean magnitude of the speed; zero without telemetry.
pub(super) fn mean_speed(readings: &[BoardReading]) -> f64 {
    let speeds = readings.iter().map(|reading| reading.motor_speed.abs());
    speeds.sum::<f64>() / readings.len().max(1) as f64
}

/// The way of wheels that slow down, m. The board takes half a second to report that they
/// stand: what is slower than [`CREEPS`] does not count.
pub(super) fn way(readings: &[BoardReading]) -> f64 {
    readings
        .windows(2)
        .take_while(|pair| pair[1].motor_speed.abs() > CREEPS)
        .map(|pair| pair[1].motor_speed.abs() * pair[1].receive.seconds_since(pair[0].receive))
        .sum()
}

/// The trouble of a motor that gave no pulse as far from neutral as the board allows.
fn never_turned() -> Trouble {
    let found = format!("no motor pulse up to {JOG_LIMIT_US} us beyond neutral");
    let fix = "Is the ESC on and started, with its battery charged? Are servo (D9) and ESC (D10) \
               swapped? Does the pulse sensor count when the wheels are turned by hand \
               (`singletrack doctor`)?";
    failed(found, fix)
}
