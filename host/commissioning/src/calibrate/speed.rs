//! Changes of speed, and roll-outs from rising speeds: the ESC, the motor, and how the car rolls.
//!
//! The motor rolls out at neutral: a brake would hide how the car rolls when nothing brakes it. The
//! speed is raised only after the roll-outs from the one below have shown what the geofence can
//! count on.

use singletrack_core::Config;

use super::floor::{self, Drive, Figure, SLOW, round};
use crate::{
    Bench, Finding, Interval, Parameter, Plot, PlotKind, PlotLine, Trouble, Verdict,
    finding::{change, failed, keys},
    fit::{self, DriveTrain},
};

/// The lower speed, m/s.
const LOW: f64 = 0.15;
/// How long each speed lasts, s.
const LASTS: f64 = 2.0;
/// How often the speed rises.
const RISES: usize = 16;
/// A rise is looked at from before to after it, s.
const LOOK: [f64; 2] = [0.4, 1.3];
/// What all rises have in common, within which 95 of 100 cars are, s, of the time constant and of
/// the dead time: the bend of the motor's map, which is known to a half (4 ms); the ESC's limit of
/// the acceleration, which looks like a longer time constant; for the dead time the stamps of the
/// cameras.
const SYSTEMATIC: [f64; 2] = [0.015, 0.006];

/// Speed and way after a time in s.
fn profile(time: f64) -> [f64; 2] {
    let period = (LOW + SLOW) * LASTS;
    let periods = (time / (2.0 * LASTS)).floor();
    let rest = time - 2.0 * LASTS * periods;
    let (speed, way) = if rest < LASTS {
        (LOW, LOW * rest)
    } else {
        (SLOW, LOW * LASTS + SLOW * (rest - LASTS))
    };
    [speed, periods * period + way]
}

pub(super) fn speed(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stands = floor::begin(bench, SLOW)?;
    let figure = Figure::find(bench, &stands)?;
    // P reaches the figure at the higher speed.
    let approach = (figure.approach() + 0.9) / SLOW;
    let seconds = approach + 2.0 * LASTS * RISES as f64;
    let drive = floor::drive(bench, seconds, "faster and slower", &|time| {
        let [speed, way] = match time < approach {
            true => [SLOW, 0.0],
            false => profile(time - approach),
        };
        Some(figure.at(SLOW * time.min(approach) + way, speed))
    })?
    .completed()?;
    let starts: Vec<f64> = (0..2 * RISES)
        .map(|index| drive.when(approach + LASTS * index as f64))
        .collect();
    let config = bench.configuration();
    let ways = ways(config, &drive);
    let pulses = drive.readings.esc();
    let esc = &config.board.esc;
    let edge = f64::from(esc.neutral_us) + f64::from(esc.deadband_us);
    let feed_forward = f64::from(config.board.speed.feed_forward_us_per_m_s);
    let about = [feed_forward.max(30.0), edge];
    let within = |from: f64, to: f64| {
        let ways = &ways[ways.partition_point(|[time, _]| *time < from)..];
        &ways[..ways.partition_point(|[time, _]| *time < to)]
    };
    let rolls: Vec<f64> = (1..RISES)
        .filter_map(|index| {
            // From the first pulse that does not drive until the next one that does.
            let fall = starts[2 * index];
            let free = |time: f64| pulses.at(time) <= edge;
            let mut steps = (0..100).map(|step| fall + 0.01 * f64::from(step));
            let from = steps.find(|time| free(*time))?;
            let to = steps.find(|time| !free(*time)).unwrap_or(fall + 1.0);
            // Both take effect later.
            fit::deceleration(within(from + 0.07, to + 0.02))
        })
        .filter(|roll| (0.05..6.0).contains(roll))
        .collect();
    let rolling = fit::median(&rolls).unwrap_or(1.0);
    let rises: Vec<DriveTrain> = (0..RISES)
        .filter_map(|index| {
            let rise = starts[2 * index + 1];
            let ways = within(rise - LOOK[0], rise + LOOK[1]);
            fit::drive_train(ways, &pulses, [LOW, SLOW], about, rolling)
        })
        .filter(|rise| rise.lag < 0.5 && rise.delay < 0.18)
        .collect();
    plot(bench, &ways, &starts);
    finding(bench, &rises, &rolls)
}

/// The speeds around all rises, over each other, and their mean.
fn plot(bench: &mut dyn Bench, ways: &[[f64; 2]], starts: &[f64]) {
    /// Poses between which a speed is taken.
    const APART: usize = 4;
    /// Over which time the mean is taken, s.
    const BIN: f64 = 0.02;
    let bins = ((LOOK[0] + LOOK[1]) / BIN) as usize;
    let mut sums = vec![[0.0; 3]; bins];
    let mut points = Vec::new();
    for rise in starts.iter().skip(1).step_by(2) {
        for pair in ways.windows(APART + 1) {
            let ([begin, from], [end, to]) = (pair[0], pair[APART]);
            let time = f64::midpoint(begin, end) - rise;
            if (-LOOK[0]..LOOK[1]).contains(&time) {
                let speed = (to - from) / (end - begin);
                points.push([time, speed]);
                if let Some(sum) = sums.get_mut(((time + LOOK[0]) / BIN) as usize) {
                    *sum = [sum[0] + time, sum[1] + speed, sum[2] + 1.0];
                }
            }
        }
        // The next one is another line.
        points.push([f64::NAN; 2]);
    }
    let mean = |[time, speed, count]: [f64; 3]| [time / count, speed / count];
    let means = sums.into_iter().map(mean).collect();
    let axes = [("time since the reference rose", "s"), ("speed", "m/s")];
    let lines = vec![
        PlotLine::new("rear axle", PlotKind::Measured, points),
        PlotLine::new("mean", PlotKind::Fitted, means),
    ];
    bench.plot(&Plot::new("speed", "Rises of the speed", axes, lines));
}

fn finding(bench: &mut dyn Bench, rises: &[DriveTrain], rolls: &[f64]) -> Result<Finding, Trouble> {
    let undetermined = || {
        let fix = "charge the battery, check that the markers are visible everywhere, and run this \
                   step again";
        failed("the changes of speed do not determine motor and ESC", fix)
    };
    if rises.len() < RISES / 2 {
        return Err(undetermined());
    }
    let interval = |of: fn(&DriveTrain) -> f64, systematic: f64| {
        // A pulse of a coarse motor sensor can spoil single rises.
        let values = typical(rises.iter().map(of).collect());
        fit::mean_interval(&values, systematic).ok_or_else(undetermined)
    };
    let gain = interval(|rise| rise.us_per_m_s, 0.0)?;
    let gain = gain.widened(0.02 * gain.value);
    let lag = interval(|rise| 1e3 * rise.lag, 1e3 * SYSTEMATIC[0])?;
    let dead = interval(|rise| 1e3 * rise.delay, 1e3 * SYSTEMATIC[1])?;
    let edge = interval(|rise| rise.edge_us, 1.0)?;
    // Less than the car needs: the proportional term would overshoot.
    let feed_forward = (0.8 * gain.value).round() as i64;
    let parameters = vec![
        Parameter::new("feed-forward", "us/(m/s)", gain)
            .written("board.speed.feed_forward_us_per_m_s", feed_forward)
            .because("less 20 %, so that the proportional gain does not overshoot"),
        Parameter::new("motor-lag", "ms", lag)
            .written("actuators.speed_lag_ms", round(lag.value, 1)),
        Parameter::new("motor-dead-time", "ms", dead).written(
            "actuators.speed_dead_time_ms",
            round(dead.value.max(0.0), 1),
        ),
    ];
    change(bench, &keys(&parameters))?;
    let is_slow = lag.value + dead.value > 300.0;
    let (count, edge_us) = (rises.len(), edge.value);
    let mut found =
        format!("{count} rises of the speed; the wheels begin to turn at {edge_us:.0} us");
    if let Some(Interval { value, .. }) = fit::mean_interval(rolls, 0.05) {
        found += &format!("; at neutral it slows down with {value:.2} m/s2");
    }
    let fix = "the motor follows slowly: lower the speeds of your references, or change the ESC's \
               settings";
    Ok(Finding::warning_if(is_slow, found, fix).with(parameters))
}

/// The values without those that are far from most.
fn typical(values: Vec<f64>) -> Vec<f64> {
    let Some(middle) = fit::median(&values) else {
        return values;
    };
    let off = values.iter().map(|value| (value - middle).abs());
    let reach = 5.0 * fit::median(off).unwrap_or(0.0);
    values
        .into_iter()
        .filter(|value| (value - middle).abs() <= reach)
        .collect()
}

/// The speeds, m/s.
const SPEEDS: [f64; 3] = [SLOW, 0.6, 1.0];
/// The roll-outs from each.
const TIMES: usize = 3;
/// How fast a car rises to its speed, m/s².
const RISES_WITH: f64 = 0.5;
/// How far it keeps it, m, and for how long more, s: the pilot tries its sensors and its brakes
/// over a metre of a new configuration.
const KEEPS: (f64, f64) = (1.5, 0.5);
/// How long of a roll-out is shown, s.
const SHOWN: f64 = 3.0;
/// A car that rolls longer than this deceleration would let it is not measured, m/s².
const LEAST: f64 = 0.2;
/// How much of the weakest roll-out the geofence counts on.
const COUNTED: f64 = 0.8;

pub(super) fn roll_out(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    floor::place(bench)?;
    let mut stops: Vec<(f64, f64)> = Vec::new();
    let mut ways = Vec::new();
    let mut passed: f64 = 0.0;
    let top = f64::from(bench.configuration().board.speed.max_forward_mm_s) * 1e-3;
    'rising: for speed in SPEEDS {
        if speed + 0.05 > top {
            break;
        }
        floor::limit_speed(bench, speed)?;
        for _ in 0..TIMES {
            let braking = rolled(bench, speed, &mut ways).inspect_err(|_| {
                // The car keeps the speed from which it has rolled out.
                let _ = floor::limit_speed(bench, passed.max(SLOW));
            })?;
            let Some(braking) = braking else {
                if passed == 0.0 {
                    let fix = "put it in the middle of the geofence, or widen fence.corners_m";
                    let found = "there is no room for a circle where the car stands";
                    return Err(failed(found, fix));
                }
                floor::limit_speed(bench, passed)?;
                break 'rising;
            };
            stops.push((speed, braking));
        }
        passed = speed;
        // The next speed counts on what this one has shown.
        let counted = counted(bench, &stops);
        if counted != bench.configuration().fence.braking_m_s2 {
            change(bench, &[("fence.braking_m_s2", counted.into())])?;
        }
    }
    let axes = [("time since neutral was asked for", "s"), ("travel", "m")];
    let lines = vec![PlotLine::new("rear axle", PlotKind::Measured, ways)];
    bench.plot(&Plot::new("roll-out", "Roll-outs", axes, lines));
    let mean = |speed: f64| {
        let stops = stops.iter().filter(|(other, _)| *other == speed);
        let of: Vec<f64> = stops.map(|(_, braking)| *braking).collect();
        Some((fit::mean(&of)?, of))
    };
    let weakest = SPEEDS
        .into_iter()
        .filter_map(mean)
        .min_by(|(one, _), (other, _)| one.total_cmp(other))
        .and_then(|(mean, of)| fit::mean_interval(&of, 0.08 * mean));
    let counted = bench.configuration().fence.braking_m_s2;
    let text: Vec<String> = stops
        .iter()
        .map(|(speed, braking)| format!("{braking:.2} from {speed:.1} m/s"))
        .collect();
    let verdict = Verdict::Failed.unless(weakest.is_some());
    let found = format!(
        "decelerations in m/s2: {}; the geofence counts on {counted}, and the car may drive up to \
         {} m/s",
        text.join(", "),
        round(passed + 0.05, 2)
    );
    let braking = weakest.map(|estimate| {
        Parameter::new("braking", "m/s2", estimate)
            .written("fence.braking_m_s2", counted)
            .because("the weakest roll-out, less 20 %")
    });
    Ok(Finding::new(verdict, found, "").with(braking.into_iter().collect()))
}

/// What the geofence may count on: the weakest roll-out, less 20 %.
fn counted(bench: &dyn Bench, stops: &[(f64, f64)]) -> f64 {
    let brakings = stops.iter().map(|(_, braking)| *braking);
    let weakest = brakings.fold(f64::INFINITY, f64::min);
    let most = bench.configuration().control.stop_deceleration_m_s2;
    ((100.0 * COUNTED * weakest).floor() / 100.0).clamp(0.05, most)
}

/// The way of the rear axle in a drive, s and m.
fn ways(config: &Config, drive: &Drive) -> Vec<[f64; 2]> {
    let cameras = &config.motion_capture;
    let [_, left] = cameras.marker_offset_m;
    let motion = drive.readings.motion(0.0);
    motion.rear_way(cameras.marker_yaw_rad, left)
}

/// Drives along a circle with this speed and lets the car roll out. Gives the deceleration,
/// m/s²; none if there is no room for it.
fn rolled(
    bench: &mut dyn Bench,
    speed: f64,
    ways: &mut Vec<[f64; 2]>,
) -> Result<Option<f64>, Trouble> {
    let stands = floor::ready(bench)?;
    let mut circle = Figure::circle(bench, &stands, speed);
    if circle.is_none() {
        floor::place(bench)?;
        let stands = floor::ready(bench)?;
        circle = Figure::circle(bench, &stands, speed);
    }
    let Some(figure) = circle else {
        return Ok(None);
    };
    let rolls_from = speed / RISES_WITH + KEEPS.0 / speed + KEEPS.1;
    let seconds = rolls_from + 0.5 + speed / LEAST;
    let text = format!("a roll-out from {speed:.1} m/s");
    let drive = floor::drive(bench, seconds, &text, &|time| {
        let now = (RISES_WITH * time).min(speed);
        let rising = now * now / (2.0 * RISES_WITH);
        let way = rising + now * (time - now / RISES_WITH);
        (time < rolls_from).then(|| figure.at(way, now))
    })?
    .completed()?;
    // The steady speed before it counts as well.
    let begin = drive.when(rolls_from) - 0.3;
    let mut rolled = self::ways(bench.configuration(), &drive);
    rolled.retain(|[time, _]| *time >= begin);
    let start = rolled.first().map_or(0.0, |[_, way]| *way);
    let shown = rolled.iter().take_while(|[time, _]| *time < begin + SHOWN);
    ways.extend(shown.map(|[time, way]| [time - begin - 0.3, way - start]));
    // The next one is another line.
    ways.push([f64::NAN; 2]);
    let braking = fit::roll_out(&rolled).ok_or_else(|| {
        let fix = "check that the floor is level and that the markers are visible everywhere, and \
                   run this step again";
        failed(format!("the car did not roll out from {speed:.1} m/s"), fix)
    })?;
    Ok(Some(braking))
}
