//! Changes of speed: the ESC, the motor, and how the car rolls.

use super::floor::{self, Figure, SLOW, round};
use crate::{
    Bench, Finding, Parameter, Plot, PlotKind, PlotLine, Step, Trouble,
    finding::failed,
    fit::{self, DriveTrain, Motion},
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

pub(super) const STEP: Step = Step::new("speed", "Changes of speed: ESC and motor", measure)
    .expecting("the speed follows within 0.3 s, and the same at every rise")
    .optional();

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

fn measure(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stands = floor::begin(bench, SLOW)?;
    let figure = Figure::find(bench, &stands)?;
    // P reaches the figure at the higher speed.
    let approach = (figure.approach() + 0.9) / SLOW;
    let seconds = approach + 2.0 * LASTS * RISES as f64;
    let mut drive = floor::drive(bench, seconds, "faster and slower", &|time| {
        if time < approach {
            return figure.at(SLOW * time, SLOW);
        }
        let [speed, way] = profile(time - approach);
        figure.at(SLOW * approach + way, speed)
    })?
    .completed()?;
    let starts: Vec<f64> = (0..2 * RISES)
        .map(|index| drive.on_track(approach + LASTS * index as f64))
        .collect();
    let config = bench.configuration();
    let motion = drive.track.motion(0.0);
    let [_, left] = config.motion_capture.marker_offset_m;
    let way = motion.rear_way(config.motion_capture.marker_yaw_rad, left);
    let pulses = drive.track.esc();
    let esc = &config.board.esc;
    let edge = f64::from(esc.neutral_us) + f64::from(esc.deadband_us);
    let about = [
        f64::from(config.board.speed.feed_forward_us_per_m_s).max(30.0),
        edge,
    ];
    let within = |from: f64, to: f64| {
        let first = motion.time.partition_point(|time| *time < from);
        let last = motion.time.partition_point(|time| *time < to);
        first..last.max(first)
    };
    let rolls: Vec<f64> = (1..RISES)
        .filter_map(|index| {
            // From the first pulse that does not drive until the next one that does.
            let fall = starts[2 * index];
            let free = |time: f64| pulses.at(time) <= edge;
            let steps = (0..100).map(|step| fall + 0.01 * f64::from(step));
            let from = steps.clone().find(|time| free(*time))?;
            let to = steps
                .clone()
                .find(|time| *time > from && !free(*time))
                .unwrap_or(fall + 1.0);
            // Both take effect later.
            let range = within(from + 0.07, to + 0.02);
            fit::deceleration(&motion.time[range.clone()], &way[range])
        })
        .filter(|roll| (0.05..6.0).contains(roll))
        .collect();
    let rolling = fit::median(&rolls).unwrap_or(1.0);
    let rises: Vec<DriveTrain> = (0..RISES)
        .filter_map(|index| {
            let rise = starts[2 * index + 1];
            let range = within(rise - LOOK[0], rise + LOOK[1]);
            let time = &motion.time[range.clone()];
            fit::drive_train(time, &way[range], &pulses, [LOW, SLOW], about, rolling)
        })
        .filter(|rise| rise.lag < 0.5 && rise.delay < 0.18)
        .collect();
    plot(bench, &motion, &way, &starts);
    finding(bench, &rises, &rolls)
}

/// The speeds around all rises, over each other, and their mean.
fn plot(bench: &mut dyn Bench, motion: &Motion, way: &[f64], starts: &[f64]) {
    /// Poses between which a speed is taken.
    const APART: usize = 4;
    /// Over which time the mean is taken, s.
    const BIN: f64 = 0.02;
    let bins = ((LOOK[0] + LOOK[1]) / BIN) as usize;
    let mut sums = vec![[0.0; 3]; bins];
    let mut points = Vec::new();
    for rise in starts.iter().skip(1).step_by(2) {
        for index in APART..motion.time.len() {
            let (begin, end) = (motion.time[index - APART], motion.time[index]);
            let time = f64::midpoint(begin, end) - rise;
            if (-LOOK[0]..LOOK[1]).contains(&time) {
                let speed = (way[index] - way[index - APART]) / (end - begin);
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
    bench.plot(&Plot {
        name: "speed",
        title: "Rises of the speed",
        x: ("time since the reference rose", "s"),
        y: ("speed", "m/s"),
        equal: false,
        lines: vec![
            PlotLine::new("rear axle", PlotKind::Measured, points),
            PlotLine::new("mean", PlotKind::Fitted, means),
        ],
    });
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
    let interval = |of: &dyn Fn(&DriveTrain) -> f64, systematic: f64| {
        // A pulse of a coarse motor sensor can spoil single rises.
        let values = typical(rises.iter().map(of).collect());
        fit::mean_interval(&values, systematic).ok_or_else(undetermined)
    };
    let gain = interval(&|rise| rise.us_per_m_s, 0.0)?;
    let gain = gain.widened(0.02 * gain.value);
    let lag = interval(&|rise| 1e3 * rise.lag, 1e3 * SYSTEMATIC[0])?;
    let dead = interval(&|rise| 1e3 * rise.delay, 1e3 * SYSTEMATIC[1])?;
    let edge = interval(&|rise| rise.edge_us, 1.0)?;
    let roll = fit::mean_interval(rolls, 0.05);
    // Less than the car needs: the proportional term would overshoot.
    let feed_forward = (0.8 * gain.value).round() as i64;
    let dead_time_ms = round(dead.value.max(0.0), 1);
    let keys: [(&'static str, toml_edit::Value); 3] = [
        ("board.speed.feed_forward_us_per_m_s", feed_forward.into()),
        ("actuators.speed_lag_ms", round(lag.value, 1).into()),
        ("actuators.speed_dead_time_ms", dead_time_ms.into()),
    ];
    floor::change(bench, &keys)?;
    let is_slow = lag.value + dead.value > 300.0;
    let found = format!(
        "{} rises of the speed; the wheels begin to turn at {:.0} us{}",
        rises.len(),
        edge.value,
        roll.map_or_else(String::new, |roll| format!(
            "; at neutral it slows down with {:.2} m/s2",
            roll.value
        ))
    );
    let fix = "the motor follows slowly: lower the speeds of your references, or change the ESC's \
               settings";
    let [gain_key, lag_key, dead_key] = keys.map(Some);
    Ok(Finding::warning_if(is_slow, found, fix).with(vec![
        Parameter::new("feed-forward", "us/(m/s)", gain, gain_key),
        Parameter::new("motor-lag", "ms", lag, lag_key),
        Parameter::new("motor-dead-time", "ms", dead, dead_key),
    ]))
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
