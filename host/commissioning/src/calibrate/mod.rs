//! The calibration: what only the floor shows.
//!
//! The car drives by itself, at first with 0.3 m/s, for as long as the operator holds the
//! dead-man switch. What a step measures is put into the configuration at once, and every step
//! can be repeated alone. The speed that the car may drive is raised only after it has stopped
//! well from the one below.

pub(crate) mod bends;
mod floor;
mod speed;

use singletrack_pilot::Reason;

pub use self::floor::lacks_room;
use self::floor::{Figure, SLOW};
use crate::{Answer, Bench, Finding, Question, Step, Trouble, Verdict, finding::stopped};

/// The steps, in their order.
pub const STEPS: [Step; 5] = [
    Step::new(
        "straight",
        "A straight metre: signs, pulses, course",
        bends::straight,
    )
    .expecting(
        "it moves along its own axis within 10 degrees, and by what the motor's pulses say within \
         15 %",
    ),
    Step::new(
        "bends",
        "Bends to both sides: steering, and the body on the car",
        bends::bends,
    )
    .expecting("the same values from every pass, near those of doctor and bring-up"),
    Step::new("speed", "Changes of speed: ESC and motor", speed::speed)
        .expecting("the speed follows within 0.3 s, and the same at every rise")
        .optional(),
    Step::new(
        "roll-out",
        "Roll-outs from rising speeds: brakes and top speed",
        speed::roll_out,
    )
    .expecting("every roll-out at least as short as fence.braking_m_s2 makes it"),
    Step::new(
        "cover",
        "Markers covered while it drives: the stop without poses",
        cover,
    )
    .expecting("it stops by itself within the distance that the geofence allows for")
    .optional(),
];

/// How long the operator has to cover the markers, s.
const SECONDS: f64 = 30.0;

fn cover(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let request = "Take a cloth or a sheet of paper. The car drives slow circles: cover its markers \
                   from above, and keep them covered until it stands.";
    if bench.ask(&Question::begin("cover-markers", request))? == Answer::Skip {
        return Ok(Finding::new(Verdict::Skipped, "not done", ""));
    }
    use Reason::{BlindTooFar, PoseHeight, PoseImplausible, PoseTooOld};

    let stands = floor::ready(bench)?;
    let figure = Figure::find(bench, &stands)?;
    let drive = floor::drive(bench, SECONDS, "cover the markers now", &|time| {
        Some(figure.at(SLOW * time, SLOW))
    })?;
    let _ = bench.ask(&Question::begin("uncover-markers", "Uncover the markers."))?;
    let Some(reason) = drive.reason else {
        let found = format!("the car drove on for {SECONDS} s: its markers were not covered");
        let fix = "run this step again, and cover all markers until the car stands";
        return Ok(Finding::warning(found, fix));
    };
    // Markers that are covered one after the other give wrong poses first.
    let by_markers = [PoseTooOld, BlindTooFar, PoseImplausible, PoseHeight];
    if !by_markers.map(Reason::name).contains(&reason) {
        return Err(stopped("stopped before its markers were covered", reason));
    }
    let config = bench.configuration();
    let supervisor = &config.supervisor;
    let allowed = supervisor.blind_distance_m.max(supervisor.hold_distance_m)
        + SLOW * SLOW / (2.0 * config.fence.braking_m_s2)
        + 0.1;
    // The way from the last pose on is that of the motor's pulses.
    let readings = &drive.readings;
    let lost = readings.poses.last().map(|pose| pose.receive);
    let lost = lost.map_or(0.0, |lost| readings.at(lost));
    let driven = readings.way();
    let way = driven.at(f64::INFINITY) - driven.at(lost);
    let found =
        format!("stopped by {reason}, {way:.2} m after the last pose; at most {allowed:.2} m");
    let fix = "run the step roll-out again: the car stops later than fence.braking_m_s2 says";
    Ok(Finding::check(way <= allowed, found, fix))
}
