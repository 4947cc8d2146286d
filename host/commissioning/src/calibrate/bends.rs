//! A straight metre, then bends to both sides with a weave: the steering, the table in its place
//! where it is no straight line, and the body on the car.

use singletrack_control::{
    CarPose, InertialSample, SteeringTable, VehicleParameters, Velocity, direction, wrap,
};
use singletrack_core::{Config, config::ServoSection};

use super::floor::{self, Figure, SLOW, Wanted, round};
use crate::{
    Bench, BoardReading, Finding, Inertial, Interval, Parameter, Plot, PlotKind, PlotLine,
    PoseReading, Trouble, Verdict,
    finding::{change, failed, keys},
    fit::{self, Body, Driven, Frames, Motion, Signal, Wheels},
    observed::Readings,
    seen,
    sensors::{self, Source},
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
    let point = stands.point;
    let point = point.ok_or_else(|| failed("no estimate", "run it again"))?;
    let velocity = SLOW * direction(yaw);
    floor::room_ahead(bench, point, METRE * direction(yaw))?;
    let wanted = |time: f64| {
        let position = point + time * velocity;
        Some(Wanted { position, velocity })
    };
    let drive = floor::drive(bench, METRE / SLOW, "a straight metre", &wanted)?.completed()?;
    let ends = [1.5, METRE / SLOW - 0.2].map(|far| drive.when(far));
    let body_yaw = bench.configuration().motion_capture.marker_yaw_rad;
    let motion = drive.readings.motion(0.0).between(ends);
    let [first, .., last] = &motion.0[..] else {
        let fix = "check that all markers are visible, and run it again";
        return Err(failed("the cameras saw too little of it", fix));
    };
    let displacement = motion.displacement(body_yaw).into_iter();
    let moved: Velocity = displacement.map(Velocity::from).sum();
    let (along, across) = (moved.x, moved.y);
    let course = across.atan2(along);
    let way = drive.readings.way();
    let ratio = (way.at(last.time) - way.at(first.time)) / along.hypot(across);
    let turn = last.yaw - first.yaw;
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
    let drive = floor::drive(bench, seconds, "circles to both sides", &|time| {
        let [offset, rate] = weave(time);
        Some(figure.at(SLOW * time, SLOW).aside(offset, rate))
    })?
    .completed()?;
    let bounds: Vec<f64> = (0..=PASSES)
        .map(|pass| drive.when((lead + 2.0 * pass as f64 * figure.lap()) / SLOW))
        .collect();
    let finding = identified(bench, &drive.readings, &bounds)?;
    let config = bench.configuration();
    Ok(with_sensors(finding, config, &drive.readings))
}

/// The finding, with each sensor beside the cameras: slope, lag and correlation.
fn with_sensors(mut finding: Finding, config: &Config, readings: &Readings) -> Finding {
    let cameras = &config.motion_capture;
    let servo = &config.board.servo;
    let pose = |pose: &PoseReading| {
        let yaw = pose.yaw - cameras.marker_yaw_rad;
        let car = PoseReading { yaw, ..*pose };
        let position = car.place_of(cameras.marker_offset_m).into();
        (pose.capture, CarPose { position, yaw })
    };
    let angle = |board: &BoardReading| {
        let off = f64::from(board.servo_us) - f64::from(servo.centre_us);
        (board.time, off / f64::from(servo.gain_us_per_rad))
    };
    let sample = |inertial: Inertial| InertialSample {
        time: inertial.time,
        yaw_rate: inertial.angular_velocity[2],
        forward_acceleration: inertial.acceleration[0],
        left_acceleration: inertial.acceleration[1],
    };
    let speed = |board: &BoardReading| (board.time, board.motor_speed);
    let read = sensors::Readings {
        inertial: readings.inertial().map(sample).collect(),
        motor: readings.boards.iter().map(speed).collect(),
        steering: readings.boards.iter().map(angle).collect(),
    };
    let poses: Vec<_> = readings.poses.iter().map(pose).collect();
    let wheelbase = config.vehicle.wheelbase_m();
    let (sensors, wrong) = sensors::compare(&seen::tell(&poses), &read, wheelbase, Source::Car);
    for sensor in &sensors {
        finding.found += &format!(
            "; {} {:.2} of the cameras, {:+.0} ms, correlation {:.2}",
            sensor.sensor,
            sensor.slope,
            1e3 * sensor.lag_s,
            sensor.correlation
        );
    }
    if !wrong.is_empty() {
        finding.verdict = finding.verdict.max(Verdict::Warning);
        let fixes = [finding.fix].into_iter().chain(wrong);
        let fixes: Vec<_> = fixes.filter(|fix| !fix.is_empty()).collect();
        finding.fix = fixes.join("; ");
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

/// The slip of the rear axle, rad per m/s² of lateral acceleration.
fn rear_slip(vehicle: &VehicleParameters) -> f64 {
    let load = vehicle.mass_kg * vehicle.front_axle_distance_m / vehicle.wheelbase_m();
    load / vehicle.rear_cornering_stiffness_n_rad
}

/// A pass around both circles, and what it shows of the body and of the steering.
struct Pass<'a> {
    driven: Driven<'a>,
    body: Body,
    wheels: Wheels,
}

impl<'a> Pass<'a> {
    fn of(motion: Motion, pulses: &'a Frames, way: &Signal, believed: &'a Config) -> Option<Self> {
        let Config { vehicle, board, .. } = believed;
        let (yaw, slip) = (believed.motion_capture.marker_yaw_rad, rear_slip(vehicle));
        let servo = &board.servo;
        let body = fit::body(&motion, way, yaw, slip)?;
        // Once more about the yaw that was found: the fit is linear in its error.
        let body = fit::body(&motion, way, body.yaw, slip)?;
        let driven = Driven {
            speed: motion.rear_speed(body.yaw, body.left, 2),
            motion,
            pulses,
            vehicle,
        };
        let wheels = driven.wheels([servo.centre_us.into(), servo.gain_us_per_rad.into()])?;
        Some(Self {
            driven,
            body,
            wheels,
        })
    }
}

fn identified(
    bench: &mut dyn Bench,
    readings: &Readings,
    bounds: &[f64],
) -> Result<Finding, Trouble> {
    let undetermined = || {
        let found = "the drive does not determine the car: too few poses, or too little steering";
        let fix = "check that all markers are visible everywhere, and run this step again";
        failed(found, fix)
    };
    let believed = bench.configuration().clone();
    let vehicle = &believed.vehicle;
    let late = readings.latency();
    let motion = readings.motion(late);
    let (pulses, way) = (readings.servo(), readings.way());
    let passes = bounds.windows(2).map(|ends| {
        let motion = motion.between([ends[0], ends[1]]);
        Pass::of(motion, &pulses, &way, &believed)
    });
    let passes: Vec<Pass<'_>> = passes.collect::<Option<_>>().ok_or_else(undetermined)?;
    if let Some(first) = passes.first() {
        plot(bench, first);
    }
    let interval = |of: fn(&Pass<'_>) -> f64, systematic: f64| {
        fit::mean_interval(passes.iter().map(of), systematic).ok_or_else(undetermined)
    };
    let slip = STIFFNESS * rear_slip(vehicle) * SLOW * SLOW;
    let of_length = RULER / vehicle.wheelbase_m();
    let gain = interval(|pass| pass.wheels.gain_us_per_rad, 0.0)?;
    let gain = gain.widened(gain.value * of_length.hypot(0.003));
    let centre = interval(|pass| pass.wheels.centre_us, 1.0)?;
    let yaw = interval(|pass| pass.body.yaw, 0.000_5)?;
    let ahead = interval(|pass| pass.body.ahead, slip.hypot(AXLE))?;
    let ahead = ahead.shifted(-vehicle.rear_axle_distance_m);
    let left = interval(|pass| pass.body.left, 0.000_5)?;
    let lag = interval(|pass| 1e3 * pass.wheels.lag, 1e3 * ALIKE[0])?;
    let dead = interval(|pass| 1e3 * pass.wheels.delay, 1e3 * ALIKE[1])?;
    let excess = [0, 1].map(|side| {
        let excesses = passes.iter().map(|pass| pass.wheels.excess[side]);
        100.0 * excesses.sum::<f64>() / passes.len() as f64
    });
    let play = fit::mean(passes.iter().map(|pass| pass.wheels.play_us));
    let play = play.ok_or_else(undetermined)?;

    let config = bench.configuration();
    let servo = &config.board.servo;
    let bent = Bent::of(&passes, servo)
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
        let new = ServoSection {
            centre_us: straight_us.round() as u16,
            gain_us_per_rad: gain.value.round() as i16,
            ..*servo
        };
        values.push(("actuators.steering_table", straight_line(&new)));
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
fn plot(bench: &mut dyn Bench, pass: &Pass<'_>) {
    const SHOWN: f64 = 6.0;
    let moments = pass.driven.motion.0.iter();
    let places = moments.map(|moment| moment.position).collect();
    let lines = vec![PlotLine::new("body", PlotKind::Measured, places)];
    let title = "The body on both circles";
    bench.plot(&Plot::new("bends", title, Plot::PLACES, lines));
    let rates = pass.driven.yaw_rates(&pass.wheels);
    let middle = rates.get(rates.len() / 2).map_or(0.0, |[time, ..]| *time);
    let shown = |of: usize| {
        let near = rates
            .iter()
            .filter(|rate| (rate[0] - middle).abs() < SHOWN / 2.0);
        near.map(|rate| [rate[0] - middle, rate[of]]).collect()
    };
    let title = "The yaw rate, measured and by the servo's pulses";
    let lines = vec![
        PlotLine::new("measured", PlotKind::Measured, shown(1)),
        PlotLine::new("fitted", PlotKind::Fitted, shown(2)),
    ];
    bench.plot(&Plot::new("steering", title, Plot::YAW_RATE, lines));
}

/// Angles that are off the line by less in all passes are left to the line, rad.
const STRAIGHT_LINE: f64 = 0.01;
/// The least room for two straight parts to a side, µs.
const ROOM_US: f64 = 80.0;

/// The steering as pairs, and how far it is from a straight line.
struct Bent {
    table: SteeringTable,
    /// The distance from the line of the angle that is farthest from it, rad.
    off: Interval,
}

impl Bent {
    /// Whether the line is worse than its tolerance.
    fn is_bent(&self) -> bool {
        self.off.low.abs().min(self.off.high.abs()) > STRAIGHT_LINE
            && self.off.low.signum() == self.off.high.signum()
    }

    /// The pairs as TOML.
    fn value(&self) -> toml_edit::Value {
        pairs(self.table.pairs().iter().copied())
    }

    /// Fits two straight parts to either side to every pass. None if the passes don't determine them,
    /// or if what they give is no table.
    fn of(passes: &[Pass<'_>], servo: &ServoSection) -> Option<Self> {
        let centre_us = fit::mean(passes.iter().map(|pass| pass.wheels.centre_us))?;
        let gain_us_per_rad = fit::mean(passes.iter().map(|pass| pass.wheels.gain_us_per_rad))?;
        let (first, last) = (&passes.first()?.driven, &passes.last()?.driven);
        let times = first.motion.0.first()?.time..last.motion.0.last()?.time;
        let driven = first
            .pulses
            .0
            .iter()
            .filter(|(time, _)| times.contains(time));
        let [least, most] = driven.fold([f64::INFINITY, 0.0_f64], |[least, most], &(_, pulse)| {
            [least.min(pulse), most.max(pulse)]
        });
        let fitted = |middle: f64| {
            if middle - least < ROOM_US || most - middle < ROOM_US {
                return None;
            }
            let halves = [least, most].map(|end| f64::midpoint(end, middle));
            let at_us = [least, halves[0], middle, halves[1], most].map(f64::round);
            let angles = passes
                .iter()
                .map(|pass| pass.driven.wheel_angles(&pass.wheels, &at_us));
            let angles: Vec<[f64; 5]> = angles.collect::<Option<_>>()?;
            let pairs = at_us.into_iter().enumerate().map(|(index, pulse)| {
                Some([pulse, fit::mean(angles.iter().map(|angles| angles[index]))?])
            });
            Some((pairs.collect::<Option<Vec<[f64; 2]>>>()?, angles))
        };
        // Where the wheels are straight the steering has its corner, if it has one. That is not where
        // the straight line has its zero.
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
        let onward = |[from, angle]: [f64; 2], [to, next]: [f64; 2], end: f64| {
            [end, next + (end - to) * (next - angle) / (to - from)]
        };
        let [min_us, max_us] = [servo.min_us, servo.max_us].map(f64::from);
        if min_us < least {
            pairs.insert(0, onward(pairs[1], pairs[0], min_us));
        }
        if max_us > most {
            let last = pairs.len() - 1;
            pairs.push(onward(pairs[last - 1], pairs[last], max_us));
        }
        for pair in &mut pairs {
            pair[1] = round(pair[1], 4);
        }
        Some(Self {
            table: SteeringTable::new(&pairs).ok()?,
            off: off?,
        })
    }
}

/// The table of this servo with a straight line: it takes the place of one that holds no more.
pub(crate) fn straight_line(servo: &ServoSection) -> toml_edit::Value {
    let (centre, gain) = (f64::from(servo.centre_us), f64::from(servo.gain_us_per_rad));
    let angle = |pulse_us: f64| round((pulse_us - centre) / gain, 4);
    let ends_us = [servo.min_us, servo.max_us].map(f64::from);
    pairs(ends_us.map(|pulse_us| [pulse_us, angle(pulse_us)]))
}

/// Pairs of pulse and angle as TOML.
fn pairs(pairs: impl IntoIterator<Item = [f64; 2]>) -> toml_edit::Value {
    toml_edit::Value::from_iter(pairs.into_iter().map(toml_edit::Value::from_iter))
}
