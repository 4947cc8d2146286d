//! A straight metre, then bends to both sides with a weave: the steering, the table in its place
//! where it is no straight line, and the body on the car.

use singletrack_control::{
    CarPose, InertialSample, Position, SteeringTable, VehicleParameters, Velocity, direction, wrap,
};
use singletrack_core::{Config, config::ServoSection};

use super::floor::{self, Drive, Figure, SLOW, Wanted, round};
use crate::{
    Bench, Finding, Interval, Observation, Parameter, Plot, PlotKind, PlotLine, Trouble, Verdict,
    finding::{change, failed, keys},
    fit::{self, Body, Frames, Motion, Signal, Track, Wheels},
    seen,
    sensors::{self, Readings, Sensor, Source},
};

/// The way, m.
const METRE: f64 = 1.2;
/// The largest angle between the body and the course, rad.
const LARGEST_COURSE: f64 = 0.17;
/// The largest difference of the ways by pulses and cameras, as a fraction.
const LARGEST_RATIO: f64 = 0.15;

pub(super) fn straight(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stands = floor::begin(bench, SLOW)?;
    let yaw = stands.pose.map_or(0.0, |(_, yaw)| yaw);
    let Some(point) = stands.point else {
        return Err(failed("no estimate", "run it again"));
    };
    let velocity = SLOW * direction(yaw);
    floor::room_ahead(bench, point, METRE * direction(yaw))?;
    let wanted = |time: f64| Wanted {
        position: point + time * velocity,
        velocity,
        rolls: false,
    };
    let mut drive = floor::drive(bench, METRE / SLOW, "a straight metre", &wanted)?.completed()?;
    let begin = drive.on_track(1.5);
    let end = drive.on_track(METRE / SLOW - 0.2);
    let Drive { track, .. } = &drive;
    let body_yaw = bench.configuration().motion_capture.marker_yaw_rad;
    let motion = track.motion(0.0);
    let inside: Vec<usize> = (0..motion.time.len())
        .filter(|&index| (begin..=end).contains(&motion.time[index]))
        .collect();
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
        let fix = "check that all markers are visible, and run it again";
        return Err(failed("the cameras saw too little of it", fix));
    };
    let [along, across] = motion.displacement(body_yaw)[first..last]
        .iter()
        .fold([0.0; 2], |sum, moved| {
            [sum[0] + moved[0], sum[1] + moved[1]]
        });
    let course = across.atan2(along);
    let way = track.way();
    let pulses = way.at(motion.time[last]) - way.at(motion.time[first]);
    let ratio = pulses / along.hypot(across);
    let turn = motion.yaw[last] - motion.yaw[first];
    let is_good = course.abs() < LARGEST_COURSE && (ratio - 1.0).abs() < LARGEST_RATIO;
    let found = format!(
        "{:.2} m at {:.1} degrees to its axis, turned by {:.1} degrees; the pulses say {:.1} % of \
         that way",
        along.hypot(across),
        course.to_degrees(),
        turn.to_degrees(),
        100.0 * ratio
    );
    let fix = "run `singletrack doctor` again: its step geometry measures the body and the pulses";
    Ok(Finding::check(is_good, found, fix))
}

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

pub(super) fn bends(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
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
    let finding = identified(bench, &drive.track, &bounds)?;
    Ok(with_sensors(
        finding,
        bench.configuration(),
        &drive.observed,
    ))
}

/// The finding, with each sensor beside the cameras: slope, lag and correlation.
fn with_sensors(mut finding: Finding, config: &Config, observed: &[Observation]) -> Finding {
    let cameras = &config.motion_capture;
    let servo = &config.board.servo;
    let mut poses = Vec::new();
    let mut readings = Readings::default();
    for observation in observed {
        match observation {
            Observation::Pose(pose) => {
                let yaw = pose.yaw - cameras.marker_yaw_rad;
                let axis = direction(yaw);
                let [ahead, left] = cameras.marker_offset_m;
                let [x, y, _] = pose.position;
                let body = ahead * axis + left * Velocity::new(-axis.y, axis.x);
                let position = Position::new(x, y) - body;
                poses.push((pose.capture, CarPose { position, yaw }));
            }
            Observation::Board(board) => {
                let off = f64::from(board.servo_us) - f64::from(servo.centre_us);
                let angle = off / f64::from(servo.gain_us_per_rad);
                readings.steering.push((board.time, angle));
                readings.motor.push((board.time, board.motor_speed));
                readings
                    .inertial
                    .extend(board.inertial.map(|inertial| InertialSample {
                        time: inertial.time,
                        yaw_rate: inertial.angular_velocity[2],
                        forward_acceleration: inertial.acceleration[0],
                        left_acceleration: inertial.acceleration[1],
                    }));
            }
            _ => {}
        }
    }
    let wheelbase = config.vehicle.wheelbase_m();
    let (sensors, wrong) = sensors::compare(&seen::tell(&poses), &readings, wheelbase, Source::Car);
    for sensor in &sensors {
        let Sensor {
            sensor,
            slope,
            lag_s,
            correlation,
            ..
        } = sensor;
        let lag = 1e3 * lag_s;
        finding.found += &format!(
            "; {sensor} {slope:.2} of the cameras, {lag:+.0} ms, correlation {correlation:.2}"
        );
    }
    if !wrong.is_empty() {
        finding.verdict = finding.verdict.max(Verdict::Warning);
        finding.fix = [finding.fix]
            .into_iter()
            .filter(|fix| !fix.is_empty())
            .chain(wrong)
            .collect::<Vec<_>>()
            .join("; ");
    }
    finding
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
    let offset_m = [ahead.value, left.value].map(|value| round(value, 5));
    let offset_m = toml_edit::Value::from_iter(offset_m);
    let mut steered_from = Parameter::new("servo-centre", "us", centre)
        .written("board.servo.centre_us", straight_us.round() as i64);
    if bent.is_some() {
        let why = "where the wheels are straight by `actuators.steering_table`";
        steered_from = steered_from.because(why);
    }
    // One key takes both of the body's places.
    let mut parameters = vec![
        steered_from,
        Parameter::new("servo-gain", "us/rad", gain)
            .written("board.servo.gain_us_per_rad", gain.value.round() as i64),
        Parameter::new("body-yaw", "rad", yaw)
            .written("motion_capture.marker_yaw_rad", round(wrap(yaw.value), 5)),
        Parameter::new("body-forward", "m", ahead)
            .written("motion_capture.marker_offset_m", offset_m.clone()),
        Parameter::new("body-left", "m", left).written("motion_capture.marker_offset_m", offset_m),
        Parameter::new("servo-lag", "ms", lag)
            .written("actuators.steering_lag_ms", round(lag.value, 1)),
        Parameter::new("servo-dead-time", "ms", dead).written(
            "actuators.steering_dead_time_ms",
            round(dead.value.max(0.0), 1),
        ),
    ];
    if let Some(bent) = &bent {
        let bend = Parameter::new("steering-bend", "rad", bent.off);
        parameters.push(bend.written("actuators.steering_table", bent.value()));
    }
    let mut values = keys(&parameters);
    let reach = (1_000.0 * reach).floor() / 1_000.0 - 0.001;
    if config.limits.max_steering_rad > reach {
        values.push(("limits.max_steering_rad", reach.into()));
    }
    if bent.is_none() && config.actuators.steering_table.is_some() {
        let ends = [servo.min_us, servo.max_us].map(f64::from);
        let line = straight_line(straight_us.round(), gain.value.round(), ends);
        values.push(("actuators.steering_table", line));
    }
    let is_doubtful =
        (gain.value / f64::from(believed.board.servo.gain_us_per_rad) - 1.0).abs() > 0.25;
    let cameras = &believed.motion_capture;
    let offset = cameras.marker_offset_m;
    let moved = (ahead.value - offset[0]).hypot(left.value - offset[1]);
    change(bench, &values)?;
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

/// Angles that are off the line by less in all passes are left to the line, rad.
const STRAIGHT_LINE: f64 = 0.01;
/// The least room for two straight parts to a side, µs.
const ROOM_US: f64 = 80.0;

/// The steering as pairs, and how far it is from a straight line.
pub(super) struct Bent {
    pub(super) table: SteeringTable,
    /// The distance from the line of the angle that is farthest from it, rad.
    pub(super) off: Interval,
}

impl Bent {
    /// Whether the line is worse than its tolerance.
    fn is_bent(&self) -> bool {
        self.off.low.abs().min(self.off.high.abs()) > STRAIGHT_LINE
            && self.off.low.signum() == self.off.high.signum()
    }

    /// The pairs as TOML.
    pub(super) fn value(&self) -> toml_edit::Value {
        pairs(self.table.pairs().iter().copied())
    }
}

/// The table of a straight line with this centre in µs and gain in µs/rad, between two pulses: it takes
/// the place of one that holds no more.
pub(crate) fn straight_line(
    centre_us: f64,
    gain_us_per_rad: f64,
    [min_us, max_us]: [f64; 2],
) -> toml_edit::Value {
    let angle = |pulse_us: f64| round((pulse_us - centre_us) / gain_us_per_rad, 4);
    pairs([min_us, max_us].map(|pulse_us| [pulse_us, angle(pulse_us)]))
}

/// Pairs of pulse and angle as TOML.
fn pairs(pairs: impl IntoIterator<Item = [f64; 2]>) -> toml_edit::Value {
    toml_edit::Value::from_iter(pairs.into_iter().map(toml_edit::Value::from_iter))
}

/// Fits two straight parts to either side to every pass. None if the passes don't determine them,
/// or if what they give is no table.
pub(super) fn bent(
    motions: &[Motion],
    pulses: &Frames,
    vehicle: &VehicleParameters,
    passes: &[(Body, Wheels)],
    servo: &ServoSection,
) -> Option<Bent> {
    let centre_us = fit::mean(passes.iter().map(|(_, wheels)| wheels.centre_us))?;
    let gain_us_per_rad = fit::mean(passes.iter().map(|(_, wheels)| wheels.gain_us_per_rad))?;
    let begin = *motions.first()?.time.first()?;
    let end = *motions.last()?.time.last()?;
    let driven = pulses
        .0
        .iter()
        .filter(|(time, _)| (begin..end).contains(time));
    let [least, most] = driven.fold([f64::INFINITY, 0.0_f64], |[least, most], &(_, pulse)| {
        [least.min(pulse), most.max(pulse)]
    });
    let fitted = |middle: f64| {
        if middle - least < ROOM_US || most - middle < ROOM_US {
            return None;
        }
        let at_us = [
            least,
            f64::midpoint(least, middle),
            middle,
            f64::midpoint(middle, most),
            most,
        ]
        .map(f64::round);
        let angles: Vec<[f64; 5]> = motions
            .iter()
            .zip(passes)
            .map(|(motion, (body, wheels))| {
                let speed = motion.rear_speed(body.yaw, body.left, 2);
                fit::wheel_angles(motion, pulses, &speed, vehicle, wheels, &at_us)
            })
            .collect::<Option<_>>()?;
        let mut pairs = Vec::with_capacity(at_us.len() + 2);
        for (index, pulse) in at_us.into_iter().enumerate() {
            pairs.push([pulse, fit::mean(angles.iter().map(|angles| angles[index]))?]);
        }
        Some((pairs, angles))
    };
    // Where the wheels are straight the steering has its corner, if it has one. That is not where the
    // straight line has its zero.
    let (first, _) = fitted(centre_us)?;
    let (mut pairs, angles) = fitted(SteeringTable::new(&first).ok()?.pulse(0.0))?;
    let mut off: Option<Interval> = None;
    for (index, [pulse, _]) in pairs.iter().enumerate() {
        let line = (pulse - centre_us) / gain_us_per_rad;
        let this = fit::mean_interval(angles.iter().map(|angles| angles[index] - line), 0.0)?;
        if off.is_none_or(|off| this.value.abs() > off.value.abs()) {
            off = Some(this);
        }
    }
    // To the ends of the servo, as at the last pulses that were driven.
    let onward = |[from, angle]: [f64; 2], [to, next]: [f64; 2], end: u16| {
        let end = f64::from(end);
        [end, next + (end - to) * (next - angle) / (to - from)]
    };
    if f64::from(servo.min_us) < least {
        pairs.insert(0, onward(pairs[1], pairs[0], servo.min_us));
    }
    if f64::from(servo.max_us) > most {
        let last = pairs.len() - 1;
        pairs.push(onward(pairs[last - 1], pairs[last], servo.max_us));
    }
    for pair in &mut pairs {
        pair[1] = round(pair[1], 4);
    }
    Some(Bent {
        table: SteeringTable::new(&pairs).ok()?,
        off: off?,
    })
}
