//! The servo: direction, centre, end stops, gain.
//!
//! An angle is read while the car is disarmed: the board leaves the servo where it was. The
//! end stops are only touched: the servo is back before the operator answers.

use singletrack_core::config::ServoSection;

use super::car::{Car, armed};
use crate::{
    Answer, Answers, Bench, BoardReading, Finding, Interval, Jog, Parameter, Trouble,
    calibrate::bends::straight_line,
    finding::{change, failed, keys, require},
    fit::wheels::fit_steering,
};

/// How far the servo turns to show its direction, us: 9 degrees with 800 us/rad.
const SHOWN_US: u16 = 120;

/// Speed of the servo's pulse, us/s, while servo and ESC may be swapped.
const CREEP_US_PER_S: f64 = 100.0;

/// Speed of the servo's pulse after that, us/s.
const TURN_US_PER_S: f64 = 600.0;

/// First and last step of the search for the centre, us.
const CENTRE_STEPS_US: [i32; 4] = [64, 32, 16, 8];

/// Most answers in one search for the centre.
const CENTRE_ANSWERS: u32 = 40;

/// Error of the eye in judging straight ahead, besides the band that looks straight: 1.5
/// degrees, rad.
const EYE_RAD: f64 = 0.026;

/// The default of `limits.max_steering_rad`.
const USUAL_STEERING_RAD: f64 = 0.45;

/// Most by which the true gain exceeds the nominal one, as a factor.
const GAIN_UNKNOWN: f64 = 1.3;

/// Where the search for the end stops begins, from the centre, and its steps, us.
const STOPS_FROM_US: i32 = 160;
const STOPS_STEP_US: i32 = 40;

/// Where angles are read, as a part of the way to the nearer end stop.
const READ_AT: [f64; 6] = [-0.9, -0.6, -0.3, 0.3, 0.6, 0.9];

/// Least scatter assumed of a protractor, rad: one degree.
const READING_RAD: f64 = 0.0175;

/// Scale error of the readings: parallax, and the linkage's curve.
const SCALE: f64 = 0.02;

/// Moves the servo to each of these pulses and leaves it at the last.
fn turn_to(bench: &mut dyn Bench, pulses_us: &[u16]) -> Result<(), Trouble> {
    armed(bench, |car| {
        let mut pulses_us = pulses_us.iter();
        pulses_us.try_for_each(|pulse_us| turn(car, *pulse_us, TURN_US_PER_S))
    })
}

/// Moves the servo within an armed jog, at this speed. No motor may turn meanwhile.
fn turn(car: &mut Car<'_>, pulse_us: u16, us_per_s: f64) -> Result<(), Trouble> {
    let rest = car.rest();
    let from = f64::from(rest.servo_us);
    let way = f64::from(pulse_us) - from;
    let begin = car.now;
    loop {
        let part = car.now.seconds_since(begin) * us_per_s / way.abs().max(1.0);
        let arrived = part >= 1.0;
        let servo_us = (from + way * part.min(1.0)).round() as u16;
        let jog = Jog { servo_us, ..rest };
        // At its end the servo needs a moment.
        let seconds = if arrived { 0.4 } else { 0.03 };
        let readings = car.hold_until(jog, seconds, "steering", BoardReading::turns)?;
        if readings.iter().any(BoardReading::turns) {
            return Err(swapped(car, jog));
        }
        if arrived {
            return Ok(());
        }
    }
}

/// The motor turns with the servo's pulse: back to where it stood still, and no farther.
fn swapped(car: &mut Car<'_>, jog: Jog) -> Trouble {
    let servo_us = car.bench().configuration().board.servo.centre_us;
    // The trouble below is reported, not the end of this jog.
    let _ = car.hold(Jog { servo_us, ..jog }, 2.0, "back to the centre");
    let found = format!(
        "the motor turned while the servo's pulse was {} us and the ESC at neutral",
        jog.servo_us
    );
    let fix = "Servo and ESC are swapped: servo to D9, ESC to D10. Or the neutral of the ESC is \
               not at board.esc.neutral_us.";
    failed(found, fix)
}

/// The side to which the front wheels point now, left positive.
fn see(bench: &mut dyn Bench) -> Result<i32, Trouble> {
    let text = "Look from behind the car, in the direction of driving: where do the front wheels \
                point?";
    let side = bench.ask_word("front-wheels", text, &["left", "straight", "right"])?;
    Ok(match side {
        "left" => 1,
        "right" => -1,
        _ => 0,
    })
}

pub(super) fn direction(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let servo = bench.configuration().board.servo;
    let believed = i32::from(servo.gain_us_per_rad).signum();
    let centre = i32::from(servo.centre_us);
    let mut seen = [0; 2];
    for attempt in 1.. {
        let way = i32::from(SHOWN_US) * attempt;
        for (seen, sign) in seen.iter_mut().zip([1, -1]) {
            let pulse_us = limited(&servo, centre + sign * way);
            armed(bench, |car| turn(car, pulse_us, CREEP_US_PER_S))?;
            *seen = sign * see(bench)?;
        }
        if seen[0] != 0 && seen[0] == seen[1] {
            break;
        }
        let found = "the front wheels did not turn to one side with a longer pulse and to the \
                     other side with a shorter one";
        let fix = "Is the servo's plug on D9, the right way round, with 5 V on it? Is its horn \
                   tight? Answer as seen from behind the car.";
        require(attempt < 2, found, fix)?;
    }
    turn_to(bench, &[servo.centre_us])?;
    let sign = seen[0];
    let longer = if sign > 0 { "left" } else { "right" };
    let found = format!("a longer pulse steers to the {longer}");
    if sign == believed {
        return Ok(Finding::good(found));
    }
    let gain = -servo.gain_us_per_rad;
    let values = vec![("board.servo.gain_us_per_rad", i64::from(gain).into())];
    change_servo(bench, values, |servo| servo.gain_us_per_rad = gain)?;
    let found = format!("{found}; board.servo.gain_us_per_rad had the other sign");
    Ok(Finding::warning(found, "None: its sign was changed."))
}

/// Searches the two edges of the band of pulses at which the wheels look straight.
///
/// Each edge is found by halving: there the answer changes from one side to straight. Every pulse is reached from the same side, so that play
/// cancels; `from` is that side.
fn find_straight(bench: &mut dyn Bench, begin: i32, from: i32) -> Result<[f64; 2], Trouble> {
    let servo = bench.configuration().board.servo;
    let sign = i32::from(servo.gain_us_per_rad).signum();
    let mut answers = 0;
    let mut look = |bench: &mut dyn Bench, pulse: i32| -> Result<i32, Trouble> {
        answers += 1;
        let found = "the answers about the front wheels contradict each other";
        let fix = "Mark straight on with a ruler along the front wheels, and look again.";
        require(answers <= CENTRE_ANSWERS, found, fix)?;
        let before = limited(&servo, pulse + from * 60);
        let pulse = limited(&servo, pulse);
        turn_to(bench, &[before, pulse])?;
        // To the side of longer pulses.
        Ok(see(bench)? * sign)
    };
    let mut edges = [0.0; 2];
    for (edge, side) in edges.iter_mut().zip([-1, 1]) {
        let mut pulse = begin;
        // Whether the wheels are seen on this side.
        let mut beyond = look(bench, pulse)? == side;
        for step in CENTRE_STEPS_US {
            let was = beyond;
            while beyond == was {
                pulse += if beyond { -side * step } else { side * step };
                beyond = look(bench, pulse)? == side;
            }
        }
        // Between this pulse and the one before.
        let back = if beyond { -side } else { side };
        *edge = f64::from(pulse) + f64::from(back * CENTRE_STEPS_US[3]) / 2.0;
    }
    Ok(edges)
}

pub(super) fn centre(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let servo = bench.configuration().board.servo;
    let up = find_straight(bench, servo.centre_us.into(), -1)?;
    let middle = f64::midpoint(up[0], up[1]);
    let down = find_straight(bench, middle.round() as i32, 1)?;
    let others = f64::midpoint(down[0], down[1]);
    let centre = f64::midpoint(middle, others);
    let play = (others - middle).abs();
    let gain = f64::from(servo.gain_us_per_rad.unsigned_abs()) * GAIN_UNKNOWN;
    let half = EYE_RAD * gain + play / 2.0 + f64::from(CENTRE_STEPS_US[3]) / 2.0;
    let centre_us = limited(&servo, centre.round() as i32);
    turn_to(bench, &[centre_us])?;
    let estimate = Interval::around(centre, half);
    let parameters = vec![
        Parameter::new("servo-centre", "us", estimate)
            .written("board.servo.centre_us", i64::from(centre_us)),
    ];
    change_servo(bench, keys(&parameters), |servo| {
        servo.centre_us = centre_us;
    })?;
    let wide = (up[1] - up[0]).abs().max((down[1] - down[0]).abs());
    let found = format!(
        "straight on at {centre:.0} us, known to {half:.0} us; it looks straight over {wide:.0} us, and \
         from the other side {play:.0} us beside"
    );
    let fix = "Reduce the play of the steering: the linkage, the servo's horn, the servo saver.";
    Ok(Finding::warning_if(play > 30.0, found, fix).with(parameters))
}

pub(super) fn stops(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let servo = bench.configuration().board.servo;
    let centre = i32::from(servo.centre_us);
    let touches = |bench: &mut dyn Bench, pulse: i32| -> Result<bool, Trouble> {
        let pulse_us = limited(&servo, pulse);
        let back = limited(&servo, i32::midpoint(centre, pulse));
        turn_to(bench, &[pulse_us, back])?;
        let text = format!(
            "The servo was at {pulse_us} us for a moment. Did it buzz, or did the wheels not \
             follow to the end?"
        );
        bench.ask_yes("at-stop", text)
    };
    let mut search = |sign: i32, farthest: u16| -> Result<(i32, Option<i32>), Trouble> {
        let mut free = centre;
        let mut pulse = centre + sign * STOPS_FROM_US;
        let stop = loop {
            pulse = limited(&servo, pulse).into();
            if touches(bench, pulse)? {
                break pulse;
            }
            free = pulse;
            if pulse == i32::from(farthest) {
                return Ok((free, None));
            }
            pulse += sign * STOPS_STEP_US;
        };
        // Halve the last step once.
        let middle = i32::midpoint(free, stop);
        let is_wide = (stop - free).abs() > STOPS_STEP_US / 2 && free != centre;
        Ok(match is_wide && touches(bench, middle)? {
            true => (free, Some(middle)),
            false if is_wide => (middle, Some(stop)),
            false => (free, Some(stop)),
        })
    };
    let (min, below) = search(-1, servo.min_us)?;
    let (max, above) = search(1, servo.max_us)?;
    turn_to(bench, &[servo.centre_us])?;
    let is_free = centre - min >= STOPS_FROM_US && max - centre >= STOPS_FROM_US;
    let found = format!("an end stop is within {STOPS_FROM_US} us of the centre");
    let fix =
        "Turn the servo's horn by a tooth so that the wheels stand straight at about 1500 us.";
    require(is_free, found, fix)?;
    let parameter = |name, key, free: i32, stop: Option<i32>| {
        let at = f64::from(free);
        let estimate = Interval::between(at, [at, stop.map_or(at, f64::from)]);
        Parameter::new(name, "us", estimate).written(key, i64::from(free))
    };
    let parameters = vec![
        parameter("servo-min", "board.servo.min_us", min, below),
        parameter("servo-max", "board.servo.max_us", max, above),
    ];
    change_servo(bench, keys(&parameters), |servo| {
        (servo.min_us, servo.max_us) = (min as u16, max as u16);
    })?;
    let said = |stop: Option<i32>| match stop {
        Some(stop) => format!("stop at {stop} us"),
        None => "no stop".into(),
    };
    Ok(Finding::good(format!(
        "free from {min} us ({}) to {max} us ({})",
        said(below),
        said(above)
    ))
    .with(parameters))
}

pub(super) fn gain(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let servo = bench.configuration().board.servo;
    let believed = f64::from(servo.gain_us_per_rad);
    let centre = i32::from(servo.centre_us);
    let range = (centre - i32::from(servo.min_us)).min(i32::from(servo.max_us) - centre);
    let text = "Read the angle of the front wheels with a protractor, left is positive: the mean \
                of the left and the right wheel.";
    let mut readings = Vec::new();
    // There and back, so that play cancels.
    for part in READ_AT.into_iter().chain(READ_AT.into_iter().rev()) {
        let pulse = centre + (part * f64::from(range)).round() as i32;
        turn_to(bench, &[limited(&servo, pulse)])?;
        let answers = Answers::Number {
            unit: "deg",
            range: [-60.0, 60.0],
        };
        let Answer::Number(degrees) = bench.answer("wheel-angle", text, answers)? else {
            return Err(Trouble::Skipped);
        };
        readings.push([f64::from(pulse), degrees.to_radians()]);
    }
    turn_to(bench, &[servo.centre_us])?;
    let unread = || {
        let fix = "Read the angle of the front wheels from straight on, left positive.";
        failed("the readings give no gain", fix)
    };
    let fit = fit_steering(&readings, READING_RAD, SCALE).ok_or_else(unread)?;
    let gain = fit.gain;
    if gain.value * believed < 0.0 {
        let found = format!(
            "the readings say {:.0} us/rad, and the wheels were seen to turn the other way",
            gain.value
        );
        let fix = "Left is positive: run the bring-up again from the direction of the servo.";
        return Err(failed(found, fix));
    }
    let rounded = gain.value.round();
    if !(50.0..=5_000.0).contains(&rounded.abs()) {
        return Err(unread());
    }
    let parameters = vec![
        Parameter::new("servo-gain", "us/rad", gain)
            .written("board.servo.gain_us_per_rad", rounded as i64),
    ];
    change_servo(bench, keys(&parameters), |servo| {
        servo.gain_us_per_rad = rounded as i16;
    })?;
    let found = format!(
        "{:.0} us/rad, {:.0} to {:.0}; the readings scatter by {:.1} degrees and say straight on \
         at {:.0} us",
        gain.value,
        gain.low,
        gain.high,
        fit.scatter.to_degrees(),
        fit.straight.value
    );
    let fix = "Read the angles again: run the bring-up with --again.";
    Ok(Finding::warning_if(fit.scatter > 0.07, found, fix).with(parameters))
}

/// Puts values of the servo in force, and lowers the steering limit to what it reaches as it is
/// `changed` by them.
fn change_servo(
    bench: &mut dyn Bench,
    mut values: Vec<(&str, toml_edit::Value)>,
    changed: impl FnOnce(&mut ServoSection),
) -> Result<(), Trouble> {
    let config = bench.configuration();
    let mut new = config.board.servo;
    changed(&mut new);
    let limit = config.limits.max_steering_rad;
    let reach = |servo: &ServoSection| {
        let [centre, min, max] = [servo.centre_us, servo.min_us, servo.max_us].map(f64::from);
        let rad = (centre - min).min(max - centre) / f64::from(servo.gain_us_per_rad).abs();
        // Written with three digits.
        (rad * 1e3).floor() / 1e3
    };
    // A limit that an earlier step lowered may rise again with the gain.
    let is_lowered = (limit - reach(&config.board.servo)).abs() < 1e-9;
    let wanted = match is_lowered {
        true => limit.max(USUAL_STEERING_RAD),
        false => limit,
    };
    let limited = wanted.min(reach(&new));
    // A table was that of another servo. The calibration measures it again.
    if config.actuators.steering_table.is_some() {
        values.push(("actuators.steering_table", straight_line(&new)));
    }
    if (limited - limit).abs() > 1e-9 {
        values.push(("limits.max_steering_rad", limited.into()));
    }
    change(bench, &values)
}

fn limited(servo: &ServoSection, pulse: i32) -> u16 {
    pulse.clamp(servo.min_us.into(), servo.max_us.into()) as u16
}
