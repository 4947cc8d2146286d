//! The markers are covered while the car drives: it stops by itself.

use singletrack_pilot::Reason;

use super::floor::{self, Drive, Ends, Figure, SLOW};
use crate::{Answer, Answers, Bench, Finding, Interrupted, Question, Verdict};

/// How long the operator has to cover the markers, s.
const SECONDS: f64 = 30.0;

/// What a stop for lack of poses is called. Markers that are covered one after the other give
/// wrong poses first.
const BY_MARKERS: [Reason; 4] = [
    Reason::PoseTooOld,
    Reason::BlindTooFar,
    Reason::PoseImplausible,
    Reason::PoseHeight,
];

const EXPECTED: &str = "it stops by itself within the way that the geofence allows for";

pub(super) fn cover(bench: &mut dyn Bench) -> Result<Finding, Interrupted> {
    let found = measure(bench);
    floor::result("cover", EXPECTED, found)
}

fn measure(bench: &mut dyn Bench) -> Result<Finding, Ends> {
    let answer = bench.ask(&Question {
        id: "cover-markers",
        text: "Take a cloth or a sheet of paper. The car drives slow circles: cover its markers \
               from above, and keep them covered until it stands."
            .to_owned(),
        answers: Answers::Begin,
    })?;
    let finding = |verdict, found: String, fix: &str| Finding {
        step: "cover",
        verdict,
        found,
        expected: EXPECTED.to_owned(),
        fix: fix.to_owned(),
        parameters: Vec::new(),
    };
    if answer == Answer::Skip {
        return Ok(finding(Verdict::Skipped, "not done".to_owned(), ""));
    }
    let stands = floor::ready(bench)?;
    let figure = Figure::find(bench, &stands)?;
    let mut drive = floor::drive(bench, SECONDS, "cover the markers now", &|time| {
        figure.at(SLOW * time, SLOW)
    })?;
    let _ = bench.ask(&Question {
        id: "uncover-markers",
        text: "Uncover the markers.".to_owned(),
        answers: Answers::Begin,
    })?;
    let Some(reason) = drive.reason else {
        return Ok(finding(
            Verdict::Warning,
            format!("the car drove on for {SECONDS} s: its markers were not covered"),
            "run this step again, and cover all markers until the car stands",
        ));
    };
    if !BY_MARKERS.map(Reason::name).contains(&reason) {
        return Ok(finding(
            Verdict::Failed,
            format!("stopped by {reason}, before its markers were covered"),
            "docs/reasons.md says what the word means; correct it and run this step again",
        ));
    }
    let config = bench.configuration();
    let supervisor = &config.supervisor;
    let allowed = supervisor.blind_distance_m.max(supervisor.hold_distance_m)
        + SLOW * SLOW / (2.0 * config.fence.braking_m_s2)
        + 0.1;
    let lost = drive.last_pose_ns;
    let way = blind_way(&mut drive, lost);
    let is_good = way <= allowed;
    Ok(finding(
        if is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        },
        format!("stopped by {reason}, {way:.2} m after the last pose; at most {allowed:.2} m"),
        if is_good {
            ""
        } else {
            "run the step roll-out again: the car stops later than fence.braking_m_s2 says"
        },
    ))
}

/// The way by the motor's pulses from the last pose on, m.
fn blind_way(drive: &mut Drive, lost_ns: u64) -> f64 {
    let lost = drive.track.seconds(lost_ns);
    let way = drive.track.way();
    way.at(f64::INFINITY) - way.at(lost)
}
