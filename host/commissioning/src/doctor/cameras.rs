//! The cameras: rate, height, identity of the body, and latency of its poses.

use std::collections::BTreeSet;

use singletrack_control::wrap;
use singletrack_core::{Config, reasons::Why};
use singletrack_pilot::Reason;

use super::gather::{Checks, ends};
use crate::{
    Bench, Finding, Interrupted, Interval, Parameter, Plot, PlotKind, PlotLine, Trouble,
    Verdict::{Failed, Good, Warning},
    fit::{Signal, mean, median, stamp_delay, standard_deviation},
    observed::Readings,
};

/// Distance from the height of the body at rest to the ends of its band, in m.
const BAND_M: f64 = 0.04;
/// The movement of the body that is asked for, and the least one that shows that the body is on
/// the car, in m.
const ENOUGH_M: f64 = 0.35;
const LEAST_M: f64 = 0.1;
/// The largest change of the height on a level floor, in m.
const CLIMB_M: f64 = 0.05;
/// For how long the car is twisted, in s, and the least angular velocity on the way, in rad/s.
const TWIST_S: f64 = 10.0;
const TWIST_RAD_S: f64 = 0.4;
/// The largest error of the camera's stamps with which a car drives well, in s.
const LATE_S: f64 = 0.005;

/// Rate, gaps, uncertainty and height; then the car is pushed.
pub(super) fn body(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let readings = checks.for_time(5.0, "cameras")?;
    if readings.poses.len() < 50 {
        let (count, states) = (readings.poses.len(), states(&readings));
        let found = format!("{count} poses in 5 s; frames without one: {states}");
        let fix = no_pose(checks.config(), &readings);
        return Err(checks.fail(found, "100 poses a second", fix));
    }
    check_stream(&readings, &mut checks);
    check_push(&mut checks)?;
    if !checks.has_failed()
        && let Some(height) = median(heights(&readings))
    {
        // To the centimetre, so that a repeated doctor changes nothing.
        let round = |value: f64| (value * 100.0).round() / 100.0;
        let band @ [low, high] = [round(height - BAND_M), round(height + BAND_M)];
        let found = format!("height {height:.3} m: band {low} to {high} m");
        checks.good(found, "the same whenever the car is on the floor");
        let key = "motion_capture.pose.height_m";
        let values = [(key, toml_edit::Value::from_iter(band))];
        if let Err(refused) = checks.put_in_force(&values)? {
            let found = format!("the band is not in force: {refused}");
            let fix = "correct what the daemon refuses, and run this step again";
            checks.add(Failed, found, "in force", fix);
        }
    }
    checks.finding()
}

fn heights(readings: &Readings) -> Vec<f64> {
    readings.poses.iter().map(|pose| pose.position[2]).collect()
}

/// The states of the frames without a pose, each once.
fn states(readings: &Readings) -> String {
    let words: BTreeSet<&str> = readings.lost.iter().copied().collect();
    match words.is_empty() {
        true => "none".to_owned(),
        false => Vec::from_iter(words).join(", "),
    }
}

/// The fix for missing poses.
fn no_pose(config: &Config, readings: &Readings) -> String {
    let cameras = &config.motion_capture;
    match readings.lost.last().copied() {
        None | Some("no-frames" | "stale") => format!(
            "nothing comes from motion_capture.server = {}, or nothing newer: look at address, network \
             interface, firewall, the streaming settings of the cameras' program and what it stamps; \
             `singletrack status` names the cause",
            cameras.server
        ),
        Some("capture-time") => "the stamps of the frames are not by the server's clock: it must stamp \
                                 the exposure, VRPN in UTC; `singletrack status` says how far they are off"
            .to_owned(),
        Some("unbound" | "absent") => format!(
            "the server does not stream a body named {:?}: compare motion_capture.rigid_body with \
             its asset list",
            cameras.rigid_body
        ),
        Some("untracked") => "the body's markers are not seen: put the car into the cameras' \
                              volume, and look for hidden markers"
            .to_owned(),
        Some(_) => "the poses are rejected: singletrack dump live --topic pose says why; an \
                    up_axis that is not the server's lays the car on its side"
            .to_owned(),
    }
}

fn check_stream(readings: &Readings, checks: &mut Checks<'_>) {
    let config = checks.config();
    let fresh = f64::from(config.supervisor.fresh_ms) * 1e-3;
    let uncertainty_limit = config.watch.max_capture_uncertainty_ms * 1e-3;
    let error_limit = config.motion_capture.pose.max_mean_error_m / 2.0;
    let rate = readings.poses.len() as f64 / readings.duration().max(1.0);
    let missing = readings.lost.len() as f64 / (readings.lost.len() + readings.poses.len()) as f64;
    let found = format!("{rate:.0} poses a second, {:.1} % missing", 100.0 * missing);
    let hidden = "set the cameras to 100 Hz, and look for markers that are hidden at times";
    let (verdict, fix) = match rate {
        80.0.. if missing < 0.02 => (Good, ""),
        45.0.. => (Warning, hidden),
        _ => (Failed, "set the cameras to 100 Hz"),
    };
    checks.add(verdict, found, "100, below 2 %", fix);
    let poses = readings.poses.iter();
    let ages = poses
        .clone()
        .map(|pose| pose.receive.seconds_since(pose.capture));
    let age = mean(ages).unwrap_or(0.0);
    let least = (fresh - 1.0 / rate.max(1.0)).max(0.0);
    let found = format!("poses are {:.0} ms old when they arrive", 1e3 * age);
    let fix = "lower the latency of cameras, their program and network; beyond a second the server's \
               stamps are by another clock than it answers with";
    let expected = format!("below {:.0} ms at this rate", 1e3 * least);
    checks.check(age < least, found, expected, fix);
    let uncertainty = poses.clone().map(|pose| pose.uncertainty);
    let uncertainty = uncertainty.fold(0.0, f64::max);
    let is_good = uncertainty < uncertainty_limit;
    let found = format!("mid-exposure known to {:.2} ms", 1e3 * uncertainty);
    let expected = format!("below {:.0} ms", 1e3 * uncertainty_limit);
    let fix = "use a server of NatNet 3.0 or later on a wired network";
    checks.check(is_good, found, expected, fix);
    let error = mean(poses.clone().map(|pose| pose.mean_error)).unwrap_or(0.0);
    let noise = |axis: usize| {
        standard_deviation(poses.clone().map(|pose| pose.position[axis])).unwrap_or(0.0)
    };
    let (error_mm, noise_mm) = (1e3 * error, 1e3 * noise(0).max(noise(1)));
    let found = format!("marker error {error_mm:.2} mm, noise {noise_mm:.2} mm");
    let expected = "half of motion_capture.pose.max_mean_error_m";
    let fix = "calibrate the cameras, and define the body again with the markers as they are now";
    checks.add(Warning.unless(error < error_limit), found, expected, fix);
}

/// A push forward: body and wheels move together.
fn check_push(checks: &mut Checks<'_>) -> Result<(), Interrupted> {
    let request = "Press Enter, then roll the car forward by half a metre, wheels on the floor.";
    if checks.skips("push", "push-forward", request)? {
        return Ok(());
    }
    let (readings, is_done) = checks.motion(|readings| {
        // A body that is not the car's does not move, and the wheels still do.
        let moved = readings.moved().max(rolled(readings));
        (format!("{moved:.2} m"), moved / ENOUGH_M)
    })?;
    if readings.is_latched() {
        checks.latched();
    }
    let (moved, rolled) = (readings.moved(), rolled(&readings));
    let found = format!("pushed: body {moved:.2} m, wheels {rolled:.2} m");
    let expected = "0.5 m, both";
    if moved < LEAST_M && rolled > LEAST_M {
        let found = format!("{found}: the body is not on this car");
        let fix = format!(
            "motion_capture.rigid_body = {:?} is another body: compare with the server's list",
            checks.config().motion_capture.rigid_body
        );
        checks.add(Failed, found, expected, fix);
        return Ok(());
    }
    if moved < LEAST_M || !is_done {
        let fix = "push the car as asked, and run this step again";
        checks.add(Failed, found, expected, fix);
        return Ok(());
    }
    if rolled < LEAST_M {
        let fix = "look at the motor's sensor and its wire to D2, see docs/uno.md; the wheels must \
                   not slide";
        checks.add(Failed, format!("{found}: no motor pulses"), expected, fix);
    } else {
        checks.good(found, expected);
    }
    let heights = heights(&readings);
    let climb = heights.iter().copied().fold(f64::MIN, f64::max)
        - heights.iter().copied().fold(f64::MAX, f64::min);
    let found = format!("its height changed by {:.0} mm", 1e3 * climb);
    let expected = format!("below {:.0} mm on a level floor", 1e3 * CLIMB_M);
    let fix = "motion_capture.up_axis is not the server's, or the ground plane is tilted: set it \
               again";
    checks.check(climb < CLIMB_M, found, expected, fix);
    if let Some(angle) = heading(&readings) {
        let degrees = angle.to_degrees();
        let (more, expected) = match angle.abs() < 0.5 {
            true => ("", "about 0"),
            false => (
                "; step geometry measures it",
                "about 0, or any: it is measured",
            ),
        };
        let found = format!("it moved at {degrees:.0} degrees to its x axis{more}");
        checks.good(found, expected);
    }
    Ok(())
}

/// The way of the wheels, by the believed distance of a pulse, in m.
fn rolled(readings: &Readings) -> f64 {
    let way = readings.boards.windows(2).map(|pair| {
        let passed = pair[1].time.seconds_since(pair[0].time).clamp(0.0, 0.1);
        pair[1].motor_speed.abs() * passed
    });
    way.sum()
}

/// The direction of the body's movement, from its x axis, in rad.
fn heading(readings: &Readings) -> Option<f64> {
    let [first, last] = ends(&readings.poses)?;
    let [x, y] = [0, 1].map(|axis| last.position[axis] - first.position[axis]);
    Some(wrap(y.atan2(x) - last.yaw))
}

/// The stamps of the cameras against the gyro, in a twist.
pub(super) fn latency(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let mut checks = Checks::begin(bench);
    let request = "Press Enter, then twist the car to and fro, 30 degrees to either side, about \
                   once a second, flat on the floor, for 12 seconds.";
    checks.needs("twist", "twist", request)?;
    let (readings, is_done) = checks.until(|readings| {
        let gyro = readings.gyro();
        let [now, rate] = gyro.last().copied().unwrap_or_default();
        let begin = gyro.iter().find(|[_, rate]| rate.abs() > TWIST_RAD_S);
        let done = begin.map_or(0.0, |[begin, _]| (now - begin) / TWIST_S);
        (format!("{:+4.0} degrees/s", rate.to_degrees()), done)
    })?;
    let angles = readings.yaws();
    let (Signal(velocities), systematic) = readings.rate();
    let uncertainty = median(readings.poses.iter().map(|pose| pose.uncertainty)).unwrap_or(0.0);
    let delay = stamp_delay(&angles, &velocities, systematic.hypot(uncertainty));
    let Some(delay) = delay.filter(|_| is_done) else {
        let again = "twist the car as asked, in view of the cameras, and run this step again";
        return Err(checks.fail("the car was not twisted", "10 s to and fro", again));
    };
    checks.bench.plot(&plot(&angles, &velocities));
    let scale = delay.scale.value;
    if scale < 0.0 {
        let found = "gyro and cameras turn in opposite directions";
        let fix = "the cameras' world is mirrored, or motion_capture.up_axis points down: set it \
                   again";
        checks.add(Failed, found, "the same", fix);
    } else {
        let found = format!("the cameras turn {scale:.3} times as far as the gyro");
        let fix = "the IMU is mounted askew, or the body is not on this car";
        checks.check((scale - 1.0).abs() < 0.1, found, "0.9 to 1.1", fix);
    }
    if !checks.has_failed() {
        judge_delay(&mut checks, delay.late.scaled(1e3));
    }
    checks.finding()
}

/// The angular velocities of both, in the middle of the twist.
fn plot(angles: &[[f64; 2]], velocities: &[[f64; 2]]) -> Plot {
    const SHOWN_S: f64 = 3.0;
    let middle = angles.get(angles.len() / 2).map_or(0.0, |[time, _]| *time);
    let shown = |rates: Vec<[f64; 2]>| {
        let is_shown = |[time, _]: &[f64; 2]| (time - middle).abs() < SHOWN_S / 2.0;
        rates.into_iter().filter(is_shown).collect()
    };
    let cameras = angles.windows(3).map(|around| {
        let ([begin, from], [end, to]) = (around[0], around[2]);
        [f64::midpoint(begin, end), (to - from) / (end - begin)]
    });
    let title = "A twist by hand, seen by gyro and cameras";
    let lines = vec![
        PlotLine::new("cameras", PlotKind::Measured, shown(cameras.collect())),
        PlotLine::new("gyro", PlotKind::Other, shown(velocities.to_vec())),
    ];
    Plot::new("latency", title, Plot::YAW_RATE, lines)
}

/// `late` is in ms, beyond the offset that is in force.
fn judge_delay(checks: &mut Checks<'_>, late: Interval) {
    let whole = late.shifted(checks.config().motion_capture.timing.stamp_offset_ms);
    // Rounded to a tenth; an offset that is already in force is not written again.
    let value = (whole.value * 10.0).round() / 10.0;
    let latency = Parameter::new("camera-latency", "ms", whole);
    checks.measured(latency.written("motion_capture.timing.stamp_offset_ms", value));
    let off = late.value.abs();
    let how = if late.value < 0.0 { "early" } else { "late" };
    let found = format!("the cameras' stamps are {off:.1} ms too {how}");
    let expected = format!("within {:.0} ms", 1e3 * LATE_S);
    match off <= 1e3 * LATE_S {
        true => checks.good(found, expected),
        false => checks.add(Warning, format!("{found}: corrected"), expected, ""),
    }
}

/// Whether the car can be armed, and its reference be driven.
pub(super) fn drive(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    use singletrack_core::feasibility::{Severity, Stand, judge_reference};

    /// How long the estimate may take to settle, in s.
    const SETTLED_S: f64 = 8.0;
    /// The longest drive that is judged, in s.
    const LONGEST_S: f64 = 60.0;

    let mut checks = Checks::begin(bench);
    let (readings, _) = checks.until(|readings| {
        let reason = readings.ticks.last().and_then(|tick| tick.preflight);
        let is_over = reason.is_none() || readings.duration() > SETTLED_S;
        let text = reason.map_or("", |reason| reason.name());
        let done = f64::from(u8::from(is_over));
        (format!("arming check: {text}"), done)
    })?;
    let tick = readings.ticks.last();
    match tick.and_then(|tick| tick.preflight) {
        None => checks.good("the car can be armed", "no refusal"),
        Some(reason @ (Reason::RealTimeUnknown | Reason::RealTimeRefused)) => {
            let found = format!("arming would be refused: {reason}");
            let fix = "grant real time: LimitRTPRIO= and LimitMEMLOCK= of the service, see \
                       docs/odroid.md";
            checks.add(Failed, found, "no refusal", fix);
        }
        Some(reason) => {
            let why = Why::of_word("host", reason.name());
            let found = format!("arming would be refused: {}", why.text);
            checks.add(Warning, found, "no refusal", why.advice.unwrap_or_default());
        }
    }
    let stand = tick.and_then(|tick| tick.pose);
    let stand = stand.map(|([x_m, y_m], yaw_rad)| Stand { x_m, y_m, yaw_rad });
    match judge_reference(checks.config(), stand, Some(LONGEST_S)) {
        Err(error) => {
            let found = format!("the configuration is invalid: {error}");
            checks.add(Failed, found, "valid", "correct it");
        }
        Ok(judgement) => {
            for finding in &judgement.findings {
                let what = &finding.what;
                let (key, value) = (what.key, &what.value);
                let found = match finding.severity {
                    Severity::Warning => format!("{key} is {value}"),
                    Severity::Impossible => format!("{key} is {value}: it can't be driven"),
                };
                checks.add(Warning, found, "", format!("{key}: {}", what.fix));
            }
            if judgement.is_possible() {
                checks.good("the reference can be driven", "inside limits and geofence");
            }
        }
    }
    checks.finding()
}
