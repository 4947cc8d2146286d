//! Bends to both sides, with a weave: the steering, and the body on the car.

use singletrack_control::{VehicleParameters, wrap};
use singletrack_core::Config;

use super::{
    floor::{self, Figure, SLOW, round},
    steering_table::{bent, straight_line},
};
use crate::{
    Bench, Finding, Interval, Parameter, Plot, PlotKind, PlotLine, Step, Trouble,
    finding::failed,
    fit::{self, Body, Frames, Motion, Signal, Track, Wheels},
};

/// How often both circles are driven.
const PASSES: usize = 5;
/// The way before the first pass that is not used, m: the car finds its way.
const LEAD: f64 = 0.9;
/// The weave: its period, s, and the speed across the course, m/s. It is strong and weak in
/// turn: play delays a slow movement for longer, and so differs from dead time.
const PERIOD: f64 = 0.8;
const ACROSS: [f64; 2] = [0.2, 0.05];
/// The periods of each.
const IN_TURN: f64 = 3.0;

/// What all passes have in common, within which 95 of 100 cars are. Time constant and dead time of
/// the servo look alike in a weave: their sum is known to 3 ms, and what one is too long the other
/// is too short, by 6 ms in most cars; s, of the time constant and of the dead time:
const ALIKE: [f64; 2] = [0.01, 0.01];
/// the axles, which are measured with a ruler, m;
const RULER: f64 = 0.002;
/// one axle, m;
const AXLE: f64 = 0.0018;
/// the slip of the tyres, whose stiffness is known to a third, rad per m/s² of lateral
/// acceleration and per rad/(m/s²) of the configured one.
const STIFFNESS: f64 = 0.35;

pub(super) const STEP: Step = Step::new(
    "bends",
    "Bends to both sides: steering, and the body on the car",
    measure,
)
.expecting("the same values from every pass, near those of doctor and bring-up");

fn measure(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stands = floor::begin(bench, SLOW)?;
    let figure = Figure::find(bench, &stands)?;
    let lead = figure.approach() + LEAD;
    let seconds = (lead + 2.0 * PASSES as f64 * figure.lap()) / SLOW;
    let mut drive = floor::drive(bench, seconds, "circles to both sides", &|time| {
        let [offset, rate] = weave(time);
        figure.at(SLOW * time, SLOW).aside(offset, rate)
    })?
    .completed()?;
    let bounds: Vec<f64> = (0..=PASSES)
        .map(|pass| drive.on_track((lead + 2.0 * pass as f64 * figure.lap()) / SLOW))
        .collect();
    identified(bench, &drive.track, &bounds)
}

/// A triangle: the offset to the left, m, and its rate, m/s.
fn weave(time: f64) -> [f64; 2] {
    let phase = (time / PERIOD).rem_euclid(1.0);
    let is_strong = (time / (IN_TURN * PERIOD)).rem_euclid(2.0) < 1.0;
    let across = ACROSS[usize::from(!is_strong)];
    // It begins and ends in the middle.
    let amplitude = across * PERIOD / 4.0;
    if phase < 0.25 {
        [amplitude * 4.0 * phase, across]
    } else if phase < 0.75 {
        [amplitude * (2.0 - 4.0 * phase), -across]
    } else {
        [amplitude * (4.0 * phase - 4.0), across]
    }
}

/// The motion between two times.
fn between(motion: &Motion, begin: f64, end: f64) -> Motion {
    let first = motion.time.partition_point(|time| *time < begin);
    let last = motion.time.partition_point(|time| *time < end).max(first);
    Motion {
        time: motion.time[first..last].to_vec(),
        position: motion.position[first..last].to_vec(),
        yaw: motion.yaw[first..last].to_vec(),
        yaw_rate: motion.yaw_rate[first..last].to_vec(),
    }
}

/// The slip of the rear axle, rad per m/s² of lateral acceleration.
fn rear_slip(vehicle: &VehicleParameters) -> f64 {
    let load = vehicle.mass_kg * vehicle.front_axle_distance_m / vehicle.wheelbase_m();
    load / vehicle.rear_cornering_stiffness_n_rad
}

fn identified(bench: &mut dyn Bench, track: &Track, bounds: &[f64]) -> Result<Finding, Trouble> {
    let undetermined = || {
        let found = "the drive does not determine the car: too few poses, or too little steering";
        let fix = "check that all markers are visible everywhere, and run this step again";
        failed(found, fix)
    };
    let believed = bench.configuration().clone();
    let vehicle = &believed.vehicle;
    let [over, of] = track.latency();
    let late = if of > 0.0 { over / of } else { 0.0 };
    let motion = track.motion(late);
    let (pulses, way) = (track.servo(), track.way());
    let motions: Vec<Motion> = bounds
        .windows(2)
        .map(|ends| between(&motion, ends[0], ends[1]))
        .collect();
    let passes: Vec<(Body, Wheels)> = motions
        .iter()
        .map(|motion| pass(motion, &pulses, &way, &believed))
        .collect::<Option<_>>()
        .ok_or_else(undetermined)?;
    if let (Some(motion), Some(first)) = (motions.first(), passes.first()) {
        plot(bench, motion, &pulses, vehicle, first);
    }
    let interval = |of: &dyn Fn(&(Body, Wheels)) -> f64, systematic: f64| {
        fit::mean_interval(passes.iter().map(of), systematic).ok_or_else(undetermined)
    };
    let speed = SLOW;
    let slip = STIFFNESS * rear_slip(vehicle) * speed * speed;
    let of_length = RULER / vehicle.wheelbase_m();
    let gain = interval(&|(_, steering)| steering.gain_us_per_rad, 0.0)?;
    let gain = gain.widened(gain.value * of_length.hypot(0.003));
    let centre = interval(&|(_, steering)| steering.centre_us, 1.0)?;
    let yaw = interval(&|(body, _)| body.yaw, 0.000_5)?;
    let ahead = interval(&|(body, _)| body.ahead, slip.hypot(AXLE))?;
    let ahead = ahead.shifted(-vehicle.rear_axle_distance_m);
    let left = interval(&|(body, _)| body.left, 0.000_5)?;
    let lag = interval(&|(_, steering)| 1e3 * steering.lag, 1e3 * ALIKE[0])?;
    let dead = interval(&|(_, steering)| 1e3 * steering.delay, 1e3 * ALIKE[1])?;
    let excess = [0, 1].map(|side| {
        let excesses = passes.iter().map(|(_, steering)| steering.excess[side]);
        100.0 * excesses.sum::<f64>() / passes.len() as f64
    });
    let play = fit::mean(passes.iter().map(|(_, steering)| steering.play_us));
    let play = play.ok_or_else(undetermined)?;

    let config = bench.configuration();
    let servo = &config.board.servo;
    let bent = bent(&motions, &pulses, vehicle, &passes, servo)
        .filter(|bent| bent.is_bent() || config.actuators.steering_table.is_some());
    let (straight_us, reach) = match &bent {
        Some(bent) => {
            let [right, left] = bent.table.reach();
            (bent.table.pulse(0.0), left.min(-right))
        }
        None => {
            let room = (f64::from(servo.max_us) - centre.value)
                .min(centre.value - f64::from(servo.min_us));
            (centre.value, room / gain.value.abs())
        }
    };
    let gain_us_per_rad = gain.value.round() as i64;
    let yaw_rad = round(wrap(yaw.value), 5);
    let offset_m = [ahead.value, left.value].map(|value| round(value, 5));
    let offset_m = toml_edit::Value::from_iter(offset_m);
    let dead_time_ms = round(dead.value.max(0.0), 1);
    let mut values: Vec<(&'static str, toml_edit::Value)> = vec![
        ("board.servo.centre_us", (straight_us.round() as i64).into()),
        ("board.servo.gain_us_per_rad", gain_us_per_rad.into()),
        ("motion_capture.marker_yaw_rad", yaw_rad.into()),
        ("motion_capture.marker_offset_m", offset_m),
        ("actuators.steering_lag_ms", round(lag.value, 1).into()),
        ("actuators.steering_dead_time_ms", dead_time_ms.into()),
    ];
    let reach = (1_000.0 * reach).floor() / 1_000.0 - 0.001;
    if config.limits.max_steering_rad > reach {
        values.push(("limits.max_steering_rad", reach.into()));
    }
    match &bent {
        Some(bent) => values.push(("actuators.steering_table", bent.value())),
        None if config.actuators.steering_table.is_some() => {
            let ends = [servo.min_us, servo.max_us].map(f64::from);
            let line = straight_line(straight_us.round(), gain.value.round(), ends);
            values.push(("actuators.steering_table", line));
        }
        None => {}
    }
    let is_doubtful =
        (gain.value / f64::from(believed.board.servo.gain_us_per_rad) - 1.0).abs() > 0.25;
    let cameras = &believed.motion_capture;
    let offset = cameras.marker_offset_m;
    let moved = (ahead.value - offset[0]).hypot(left.value - offset[1]);
    floor::change(bench, &values)?;
    let parameter = |name, unit, estimate: Interval, key: &str| {
        let key = values.iter().find(|(other, _)| *other == key).cloned();
        Parameter::new(name, unit, estimate, key)
    };
    let dead_time_key = "actuators.steering_dead_time_ms";
    let mut parameters = vec![
        parameter("servo-centre", "us", centre, "board.servo.centre_us"),
        parameter("servo-gain", "us/rad", gain, "board.servo.gain_us_per_rad"),
        parameter("body-yaw", "rad", yaw, "motion_capture.marker_yaw_rad"),
        parameter("body-forward", "m", ahead, "motion_capture.marker_offset_m"),
        parameter("body-left", "m", left, "motion_capture.marker_offset_m"),
        parameter("servo-lag", "ms", lag, "actuators.steering_lag_ms"),
        parameter("servo-dead-time", "ms", dead, dead_time_key),
    ];
    if let Some(bent) = &bent {
        let key = "actuators.steering_table";
        parameters.push(parameter("steering-bend", "rad", bent.off, key));
    }
    let found = format!(
        "{} passes; stamps late by another {:.1} ms; the body {:.1} mm and {:.2} degrees from where \
         it was; play {play:.0} us; bends to the left {:+.1} % and to the right {:+.1} % tighter \
         than the map",
        passes.len(),
        1e3 * late,
        1e3 * moved,
        wrap(yaw.value - cameras.marker_yaw_rad).to_degrees(),
        excess[0],
        excess[1]
    );
    let fix = "the gain differs by more than a quarter from that of bring-up: measure \
               vehicle.front_axle_distance_m and rear_axle_distance_m again";
    Ok(Finding::warning_if(is_doubtful, found, fix).with(parameters))
}

/// The way of the body in a pass, and the yaw rate in the middle of it.
fn plot(
    bench: &mut dyn Bench,
    motion: &Motion,
    pulses: &Frames,
    vehicle: &VehicleParameters,
    (body, steering): &(Body, Wheels),
) {
    const SHOWN: f64 = 6.0;
    let places = PlotLine::new("body", PlotKind::Measured, motion.position.clone());
    let title = "The body on both circles";
    bench.plot(&Plot::of_places("bends", title, vec![places]));
    let speed = motion.rear_speed(body.yaw, body.left, 2);
    let rates = fit::yaw_rates(motion, pulses, &speed, vehicle, steering);
    let middle = rates.get(rates.len() / 2).map_or(0.0, |[time, ..]| *time);
    let shown = |of: usize| {
        rates
            .iter()
            .filter(|rate| (rate[0] - middle).abs() < SHOWN / 2.0)
            .map(|rate| [rate[0] - middle, rate[of]])
            .collect::<Vec<_>>()
    };
    let (measured, fitted) = (shown(1), shown(2));
    let title = "The yaw rate, measured and by the servo's pulses";
    let axis = ("yaw rate", "rad/s");
    let lines = vec![
        PlotLine::new("measured", PlotKind::Measured, measured),
        PlotLine::new("fitted", PlotKind::Fitted, fitted),
    ];
    bench.plot(&Plot::over_time("steering", title, axis, lines));
}

/// One pass.
fn pass(
    motion: &Motion,
    pulses: &Frames,
    way: &Signal,
    believed: &Config,
) -> Option<(Body, Wheels)> {
    let Config { vehicle, board, .. } = believed;
    let (yaw, slip) = (believed.motion_capture.marker_yaw_rad, rear_slip(vehicle));
    let servo = &board.servo;
    let servo = [servo.centre_us.into(), servo.gain_us_per_rad.into()];
    let body = fit::body(motion, way, yaw, slip)?;
    // Once more about the yaw that was found: the fit is linear in its error.
    let body = fit::body(motion, way, body.yaw, slip)?;
    let speed = motion.rear_speed(body.yaw, body.left, 2);
    let steering = fit::wheels(motion, pulses, &speed, vehicle, servo)?;
    Some((body, steering))
}
