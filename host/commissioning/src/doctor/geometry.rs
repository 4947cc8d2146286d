//! Place of the body on the car, and distance of a motor pulse.

use core::f64::consts::TAU;

use singletrack_control::{Time, unwrap_near, wrap};

use super::gather::{Checks, distance, ends, turned};
use crate::{
    Bench, BoardReading, Finding, Interval, Parameter, Plot, PlotKind, PlotLine, PoseReading,
    Trouble,
    Verdict::{Failed, Warning},
    fit::{Rolled, mean, mean_interval, rolled, turned_about},
    observed::Readings,
};

/// Turns to each side, and rolls.
const TURNS: usize = 2;
const ROLLS: usize = 4;
/// The least angle of a turn, in rad: three quarters of a turn.
const ENOUGH_RAD: f64 = 0.75 * TAU;
/// The least way of a roll, in m.
const ENOUGH_M: f64 = 1.4;
/// Accuracy with which a person keeps the middle of an axle over a point, in m.
const AXLE_M: f64 = 0.004;
/// A point that wandered more than this was not held, in m.
const HELD_M: f64 = 0.02;
/// The angle between the car and the way of its rear axle, in rad: play and toe of the wheels.
const TOE_RAD: f64 = 0.003;
/// The share of the wheels' way that is lost by slip, or by a tyre that is loaded otherwise.
const SLIP: f64 = 0.003;
/// Mean loss by the resolution of the board's speed, which rounds towards zero, in m/s.
const HALF_STEP_M_S: f64 = 0.000_5;
/// The share of the highest speed of a stretch from which on it counts for the pulses.
const STEADY: f64 = 0.85;
/// A slower body stands, in m/s.
const SLOW_M_S: f64 = 0.08;
/// A shorter stretch is not counted, in s.
const STRETCH_S: f64 = 0.2;
/// A roll that turned more than this was not straight, in rad.
const STRAIGHT_RAD: f64 = 0.6;

/// Pivot, yaw and pulse distance, by turns and rolls.
pub(super) fn geometry(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let origins = turns(&mut checks)?;
    let axis = |index: usize| mean_interval(origins.iter().map(|origin| origin[index]), AXLE_M);
    let (Some(along), Some(across)) = (axis(0), axis(1)) else {
        return checks.finding();
    };
    let passes = rolls([along.value, across.value], &mut checks)?;
    let yaws = passes.iter().map(|pass| -pass.rolled.direction);
    let first = yaws.clone().next().unwrap_or(0.0);
    if let Some(yaw) = mean_interval(yaws.map(|yaw| unwrap_near(yaw, first)), TOE_RAD) {
        place([along, across], yaw, &mut checks);
    }
    pulses(&passes, &mut checks);
    checks.finding()
}

/// The origin of the body from the rear axle, along the body's axes, by each turn.
fn turns(checks: &mut Checks<'_>) -> Result<Vec<[f64; 2]>, Trouble> {
    let mut origins = Vec::new();
    let mut paths = [const { Vec::new() }; 2];
    let left = "Mark a point on the floor and put the middle of the rear axle over it. Press Enter, \
                then turn the car to the left by a whole turn, in about ten seconds, and keep the \
                middle of the rear axle over the point.";
    let right = "Put the middle of the rear axle over the point again. Press Enter, then turn the car \
                 to the right by a whole turn, in about ten seconds, and keep the middle of the \
                 rear axle over the point.";
    let both = [
        ("turn-left-about-rear-axle", left),
        ("turn-right-about-rear-axle", right),
    ];
    for (id, request) in both.into_iter().cycle().take(2 * TURNS) {
        checks.needs("turn about the rear axle", id, request)?;
        let (readings, is_done) = checks.motion(|readings| {
            let angle = turned(&readings.poses);
            let text = format!("{:+.0} degrees", angle.to_degrees());
            (text, angle.abs() / ENOUGH_RAD)
        })?;
        let poses = &readings.poses;
        let found = turned_about(poses).filter(|_| is_done);
        let Some((origin, _)) = found.filter(|(_, wander)| *wander < HELD_M) else {
            let wandered = |(_, by)| format!("the rear axle wandered by {:.0} mm", 1e3 * by);
            let found = found.map_or_else(|| "the car was not turned".to_owned(), wandered);
            let expected = "a whole turn about the middle of the rear axle";
            return Err(checks.fail(found, expected, "turn it as asked, and run this step again"));
        };
        origins.push(origin);
        for (path, held) in paths.iter_mut().zip([[0.0; 2], origin]) {
            path.extend(poses.iter().map(|pose| pose.place_of(held)));
            // A NaN separates the lines of two turns.
            path.push([f64::NAN; 2]);
        }
    }
    let [body, axle] = paths;
    let lines = vec![
        PlotLine::new("body", PlotKind::Measured, body),
        PlotLine::new("rear axle", PlotKind::Fitted, axle),
    ];
    let title = "Turns about the rear axle";
    let plot = Plot::new("turns", title, Plot::PLACES, lines);
    checks.bench.plot(&plot);
    Ok(origins)
}

/// A pass of the car over the floor.
struct Pass {
    /// How the rear axle rolled.
    rolled: Rolled,
    /// Way by the cameras over way by the pulses, where the car was fast.
    ratio: Option<f64>,
    /// Seconds of the board's clock in a second.
    clock: f64,
}

fn rolls(origin: [f64; 2], checks: &mut Checks<'_>) -> Result<Vec<Pass>, Trouble> {
    let believed = 1e-6 * f64::from(checks.config().board.speed.pulse_distance_um);
    let mut passes = Vec::new();
    let mut is_latched = false;
    for _ in 0..ROLLS {
        // The board takes wheels that turn for longer for a motor that runs.
        let request = "Put the car where the cameras see the next two metres in front of it, \
                       wheels straight. Press Enter, then roll it forward by two metres, in \
                       stretches of half a metre that take a second or two each, with a pause of a \
                       second between them: wheels that turn for longer count as a motor that \
                       runs. Push from behind, not to the side.";
        checks.needs("roll", "roll-forward", request)?;
        let (readings, is_done) = checks.motion(|readings| {
            let way = readings.moved();
            (format!("{way:.2} m"), way / ENOUGH_M)
        })?;
        let Some(found) = rolled(&readings.poses, origin).filter(|_| is_done) else {
            let expected = "2 m, or 1.5 m at least";
            let fix = "roll it as asked, and run this step again";
            return Err(checks.fail("the car was not rolled", expected, fix));
        };
        is_latched |= readings.is_latched();
        let about = ratio(&readings, origin, believed);
        passes.push(Pass {
            rolled: found,
            ratio: about.and_then(|share| ratio(&readings, origin, share * believed)),
            clock: clock(&readings.boards),
        });
    }
    if is_latched {
        checks.latched();
    }
    let way = mean(passes.iter().map(|pass| pass.rolled.way)).unwrap_or(0.0);
    let turns = passes.iter().map(|pass| pass.rolled.turn.abs());
    let turn = turns.fold(0.0, f64::max);
    let degrees = turn.to_degrees();
    let found = format!("{ROLLS} rolls of {way:.2} m, turned by {degrees:.0} degrees at most");
    let fix = "put the front wheels straight, and repeat";
    let verdict = Warning.unless(turn < STRAIGHT_RAD);
    checks.add(verdict, found, "below 34 degrees", fix);
    Ok(passes)
}

/// Where the body is on the car.
fn place(origin: [Interval; 2], yaw: Interval, checks: &mut Checks<'_>) {
    let rear = checks.config().vehicle.rear_axle_distance_m;
    let [along, across] = origin;
    // From the body's axes to those of the car.
    let (sin, cos) = yaw.value.sin_cos();
    let spin = yaw.half_width();
    let turned = |a: f64, b: f64| {
        let (one, other) = (a * along.half_width(), b * across.half_width());
        // The lever of an error of the yaw is the other part.
        let lever = a * across.value - b * along.value;
        let width = one.hypot(other).hypot(spin * lever);
        Interval::around(a * along.value + b * across.value, width)
    };
    let forward = turned(cos, -sin).shifted(-rear);
    let left = turned(sin, cos);
    let found = format!(
        "the body's pivot is {:.0} mm in front of the centre of mass and {:.0} mm to its \
         left, turned by {:.1} degrees",
        1e3 * forward.value,
        1e3 * left.value,
        yaw.value.to_degrees()
    );
    checks.good(found, "where its markers are");
    let round = |value: f64, digits: f64| (value * digits).round() / digits;
    let offset = [round(forward.value, 1e4), round(left.value, 1e4)];
    if !offset.iter().all(|part| part.abs() < 1.0) {
        let found = "the pivot is more than 1 m away";
        let fix = "define the body's pivot on the car, in the cameras' program";
        checks.add(Failed, found, "", fix);
    }
    let yaw = yaw.shifted(wrap(yaw.value) - yaw.value);
    let rounded = round(yaw.value, 1e4);
    let yaw = Parameter::new("body-yaw", "rad", yaw);
    checks.measured(yaw.written("motion_capture.marker_yaw_rad", rounded));
    // One key takes both values.
    let offset = toml_edit::Value::from_iter(offset);
    let forward = Parameter::new("body-forward", "m", forward);
    checks.measured(forward.written("motion_capture.marker_offset_m", offset));
    checks.measured(Parameter::new("body-left", "m", left));
}

/// The distance of a pulse.
fn pulses(passes: &[Pass], checks: &mut Checks<'_>) {
    let believed = f64::from(checks.config().board.speed.pulse_distance_um);
    let ratios: Vec<f64> = passes.iter().filter_map(|pass| pass.ratio).collect();
    let fix = "look at the motor's sensor and its wire to D2, see docs/uno.md";
    let Some(ratio) = mean_interval(&ratios, 0.0).filter(|_| ratios.len() == passes.len()) else {
        let expected = "pulses while the wheels turn";
        return checks.add(Failed, "no motor pulses", expected, fix);
    };
    let ratio = ratio.widened(SLIP * ratio.value);
    let distance = ratio.scaled(believed);
    // The board divides by its own seconds: with this distance its speed is right.
    let clock = mean(passes.iter().map(|pass| pass.clock)).unwrap_or(1.0);
    let written = (distance.value * clock).round();
    let found = format!(
        "{:.0} um in a pulse, {written:.0} by the board's clock, which is {:+.2} % fast; \
         configured were {believed:.0}",
        distance.value,
        100.0 * (clock - 1.0)
    );
    checks.good(found, "as measured");
    let share = ratio.half_width() / ratio.value;
    if share > 0.05 {
        let found = format!("it is known to {:.0} % only", 100.0 * share);
        let fix = "roll the car for the whole two metres, at an even speed";
        checks.add(Warning, found, "5 %", fix);
    }
    // Outside of what the board can count.
    if !(100.0..=30_000.0).contains(&distance.value) {
        let found = format!("a pulse every {:.2} mm", 1e-3 * distance.value);
        checks.add(Failed, found, "0.1 to 30 mm", fix);
    }
    let distance = Parameter::new("pulse-distance", "um", distance)
        .written("board.speed.pulse_distance_um", written as i64)
        .because("by the board's clock, which divides by it");
    checks.measured(distance);
}

/// Way by the cameras over way by the pulses, of the rear axle, while the car was fast. The car
/// may have been rolled in several stretches.
///
/// The board measures a speed over the time between two pulses and keeps it until the next one:
/// on the average it is late by the time of a pulse, with a period of the board on top. The pulse
/// is `pulse` long, in m.
fn ratio(readings: &Readings, origin: [f64; 2], pulse: f64) -> Option<f64> {
    const PERIOD_S: f64 = 0.005;
    let speeds = speeds(&readings.poses);
    let clock = clock(&readings.boards);
    let mut by_pulses = 0.0;
    let mut by_cameras = 0.0;
    for stretch in speeds.chunk_by(|left, right| (left.1 > SLOW_M_S) == (right.1 > SLOW_M_S)) {
        let highest = stretch.iter().map(|(_, speed)| *speed).fold(0.0, f64::max);
        let fast = stretch
            .iter()
            .filter(|(_, speed)| *speed > STEADY * highest);
        let fast: Vec<Time> = fast.map(|(time, _)| *time).collect();
        let Some([&begin, &end]) = ends(&fast).filter(|_| highest > SLOW_M_S) else {
            continue;
        };
        let lasts = end.seconds_since(begin);
        if lasts < STRETCH_S {
            continue;
        }
        let way = way(&readings.poses, origin, begin, end)?;
        by_cameras += way;
        let late = PERIOD_S + pulse * lasts / way;
        by_pulses += wheel_way(&readings.boards, begin, end, late) * clock;
    }
    (by_pulses > 0.0).then(|| by_cameras / by_pulses)
}

/// Seconds of the board's clock in a second: a ceramic resonator is up to 0.5 % wrong.
fn clock(boards: &[BoardReading]) -> f64 {
    let seconds = ends(boards).map(|[first, last]| {
        let own = f64::from(last.board_us.wrapping_sub(first.board_us)) * 1e-6;
        (own, last.time.seconds_since(first.time))
    });
    seconds
        .filter(|(_, passed)| *passed > 1.0)
        .map_or(1.0, |(own, passed)| own / passed)
}

/// The speed of the body at its poses, over a tenth of a second.
fn speeds(poses: &[PoseReading]) -> Vec<(Time, f64)> {
    const AROUND: usize = 5;
    let speeds = poses.windows(2 * AROUND + 1).filter_map(|window| {
        let [first, last] = ends(window)?;
        let time = last.capture.seconds_since(first.capture);
        let speed = distance(first.position, last.position) / time;
        // A gap is no movement.
        (time < 0.3).then_some((window[AROUND].capture, speed))
    });
    speeds.collect()
}

/// The way of the wheels between two moments, by the believed distance of a pulse, if their speed
/// is measured late, in s.
fn wheel_way(boards: &[BoardReading], begin: Time, end: Time, late: f64) -> f64 {
    boards
        .windows(2)
        .map(|pair| {
            let from = (pair[0].time.seconds_since(begin) - late).max(0.0);
            let to = (pair[1].time.seconds_since(begin) - late).min(end.seconds_since(begin));
            let rounded_off = if pair[1].turns() { HALF_STEP_M_S } else { 0.0 };
            (pair[1].motor_speed.abs() + rounded_off) * (to - from).max(0.0)
        })
        .sum()
}

/// The way of the rear axle between two moments, along its path.
fn way(poses: &[PoseReading], origin: [f64; 2], begin: Time, end: Time) -> Option<f64> {
    let at = |time: Time| {
        let after = poses.partition_point(|pose| time.seconds_since(pose.capture) >= 0.0);
        let (before, after) = (poses.get(after.checked_sub(1)?)?, poses.get(after)?);
        let gap = after.capture.seconds_since(before.capture);
        let share = time.seconds_since(before.capture) / gap;
        let ends = [before, after].map(|pose| pose.place_of(origin));
        let place = [0, 1].map(|axis| ends[0][axis] + share * (ends[1][axis] - ends[0][axis]));
        (gap < 0.2).then_some((place, before.yaw))
    };
    let ((from, yaw), (to, later)) = (at(begin)?, at(end)?);
    let chord = (to[0] - from[0]).hypot(to[1] - from[1]);
    // The arc over a chord, of a car that turned by this angle.
    let half = wrap(later - yaw).abs() / 2.0;
    Some(chord * if half > 1e-3 { half / half.sin() } else { 1.0 })
}
