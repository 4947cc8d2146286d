//! Judges whether the car can drive its reference from where it stands.
//!
//! It takes 10 to 300 ms of a processor, and with a governor up to some seconds, on a thread that
//! nothing waits for but the client that asked.

use std::time::Duration;

use singletrack_core::{
    config::Config,
    feasibility::{Finding, Severity, Stand, judge_reference},
};

use crate::snapshot::Snapshot;

/// Where the car stands by its estimate; `None` without one.
pub(crate) fn stand(snapshot: &Snapshot) -> Option<Stand> {
    let estimate = snapshot.output()?.estimate?;
    Some(Stand {
        x_m: estimate.position.x,
        y_m: estimate.position.y,
        yaw_rad: estimate.yaw,
    })
}

/// Why the car can't drive its reference from there, for this time at most; `None` if it can.
pub(crate) fn refusal(
    config: &Config,
    stand: Option<Stand>,
    longest: Option<Duration>,
) -> Option<String> {
    let longest_s = longest.map(|time| time.as_secs_f64());
    let findings = match judge_reference(config, stand, longest_s) {
        Ok(judgement) if judgement.is_possible() => return None,
        Ok(judgement) => judgement.findings,
        Err(error) => return Some(error.to_string()),
    };
    let reasons: Vec<String> = findings
        .iter()
        .filter(|finding| finding.severity == Severity::Impossible)
        .map(ToString::to_string)
        .collect();
    Some(reasons.join("; "))
}

/// What should be known about a reference that is in force, in one line each.
pub(crate) fn warnings(config: &Config, stand: Option<Stand>) -> Vec<String> {
    let text = |finding: &Finding| match finding.severity {
        Severity::Warning => finding.to_string(),
        Severity::Impossible => format!("impossible: {finding}"),
    };
    match judge_reference(config, stand, None) {
        Ok(judgement) => judgement.findings.iter().map(text).collect(),
        Err(error) => vec![error.to_string()],
    }
}
