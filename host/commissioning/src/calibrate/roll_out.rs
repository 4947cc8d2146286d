//! Roll-outs from rising speeds, with the motor at neutral: a brake would hide how the car rolls
//! when nothing brakes it. The speed is raised only after the roll-outs from the one below have
//! shown what the geofence can count on.

use super::floor::{self, Figure, SLOW, Wanted, round};
use crate::{
    Bench, Finding, Parameter, Plot, PlotKind, PlotLine, Step, Trouble, Verdict, finding::failed,
    fit,
};

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

pub(super) const STEP: Step = Step::new(
    "roll-out",
    "Roll-outs from rising speeds: brakes and top speed",
    measure,
)
.expecting("every roll-out at least as short as fence.braking_m_s2 makes it");

fn measure(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
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
            floor::change(bench, &[("fence.braking_m_s2", counted.into())])?;
        }
    }
    bench.plot(&Plot {
        name: "roll-out",
        title: "Roll-outs",
        x: ("time since neutral was asked for", "s"),
        y: ("way", "m"),
        equal: false,
        lines: vec![PlotLine::new("rear axle", PlotKind::Measured, ways)],
    });
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
    let verdict = match weakest {
        Some(_) => Verdict::Good,
        None => Verdict::Failed,
    };
    let found = format!(
        "decelerations in m/s2: {}; the geofence counts on {counted}, and the car may drive up to \
         {} m/s",
        text.join(", "),
        round(passed + 0.05, 2)
    );
    let braking = weakest.map(|estimate| {
        let key = ("fence.braking_m_s2", counted.into());
        Parameter::new("braking", "m/s2", estimate, Some(key))
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

/// Drives along a circle with this speed and lets the car roll out. Gives the deceleration,
/// m/s²; none if there is no room for it.
fn rolled(
    bench: &mut dyn Bench,
    speed: f64,
    ways: &mut Vec<[f64; 2]>,
) -> Result<Option<f64>, Trouble> {
    let mut stands = floor::ready(bench)?;
    let mut circle = Figure::circle(bench, &stands, speed);
    if circle.is_none() {
        floor::place(bench)?;
        stands = floor::ready(bench)?;
        circle = Figure::circle(bench, &stands, speed);
    }
    let Some(figure) = circle else {
        return Ok(None);
    };
    let rolls_from = speed / RISES_WITH + KEEPS.0 / speed + KEEPS.1;
    let seconds = rolls_from + 0.5 + speed / LEAST;
    let text = format!("a roll-out from {speed:.1} m/s");
    let mut drive = floor::drive(bench, seconds, &text, &|time| {
        let now = (RISES_WITH * time).min(speed);
        let rising = now * now / (2.0 * RISES_WITH);
        let way = rising + now * (time - now / RISES_WITH);
        Wanted {
            rolls: time >= rolls_from,
            ..figure.at(way, now)
        }
    })?
    .completed()?;
    let config = bench.configuration();
    let [_, left] = config.motion_capture.marker_offset_m;
    // The steady speed before it counts as well.
    let begin = drive.on_track(rolls_from) - 0.3;
    let motion = drive.track.motion(0.0);
    let way = motion.rear_way(config.motion_capture.marker_yaw_rad, left);
    let first = motion.time.partition_point(|time| *time < begin);
    let ends = motion.time.partition_point(|time| *time < begin + SHOWN);
    let shown = first..ends.max(first);
    ways.extend(shown.map(|index| [motion.time[index] - begin - 0.3, way[index] - way[first]]));
    // The next one is another line.
    ways.push([f64::NAN; 2]);
    fit::roll_out(&motion.time[first..], &way[first..])
        .map(Some)
        .ok_or_else(|| {
            let fix = "check that the floor is level and that the markers are visible everywhere, \
                       and run this step again";
            failed(format!("the car did not roll out from {speed:.1} m/s"), fix)
        })
}
