//! Requests to arm and to jog: the checks before they reach the pilot, whether the car can drive its
//! reference from where it stands, and timed drives.
//!
//! A task of this thread renews a timed drive until its time is over. If the thread dies, the
//! renewals end too, and the car stops.

use std::time::Duration;

use singletrack_api::{Answer, Code, RENEWAL, Refused};
use singletrack_core::{
    ControlRequest, certificate,
    config::Config,
    feasibility::{Finding, Severity, Stand, judge_reference},
};
use singletrack_pilot::{Arming, Mode, PilotRequest};
use tokio::{
    task::spawn_blocking,
    time::{Instant, MissedTickBehavior, interval},
};

use super::{
    command::{Arm, Attendance},
    drives::{DriveWatch, Progress, Ticket, cannot_arm, not_ready},
};
use crate::{
    clock::monotonic_ns,
    handle::{DaemonHandle, Snapshot},
};

/// Requests to arm an unattended or timed drive, and waits for the outcome.
pub(super) async fn arm(daemon: &DaemonHandle, request: Arm) -> Result<(), Refused> {
    let (ticket, mut watch) = begin(daemon, request).await?;
    if let Attendance::Timed(time) = request.attendance {
        // Renews also while the board arms.
        tokio::spawn(renew(ticket, daemon.clone(), time));
    }
    loop {
        match watch.next(daemon).await {
            Progress::Arming => {}
            Progress::Driving(_) | Progress::Ended(..) => return Ok(()),
            Progress::Refused(error) => return Err(error),
        }
    }
}

/// The answer to a client whose drive has begun, with what is wrong with its record.
pub(super) fn drive_begun(daemon: &DaemonHandle) -> Answer {
    Answer {
        warnings: daemon.record_trouble().into_iter().collect(),
        ..Answer::done()
    }
}

/// Passes a request to arm on, if the car can drive its reference from where it stands.
///
/// The judgement takes up to 0.3 s. Meanwhile other clients are served and the car stands:
/// nothing has been asked of the pilot. A disarm, a stop, another mode or another configuration
/// that comes in this time ends the request.
pub(super) async fn begin(
    daemon: &DaemonHandle,
    request: Arm,
) -> Result<(Ticket, DriveWatch), Refused> {
    let (attendance, start_ns) = (request.attendance, request.start_ns);
    ready(daemon)?;
    let judging = daemon.drives.judging().try_lock_owned();
    let why = "the request of another client is being judged";
    let judging = judging.map_err(|_| cannot(Code::OtherClient, why))?;
    let stops = daemon.drives.stops();
    let judged = daemon.clone();
    let longest = match attendance {
        Attendance::Timed(time) => Some(time),
        Attendance::Hold | Attendance::Unattended => None,
    };
    let judgement = spawn_blocking(move || {
        // Also held if the client hangs up.
        let _judging = judging;
        let (number, config) = judged.reconfigurer.in_force();
        let snapshot = judged.snapshot();
        let stand = stand(&snapshot);
        let tuned = snapshot.output().and_then(|output| output.tuned);
        let refused = |code| move |why: String| cannot(code, &why);
        let refusal = match request.uncalibrated {
            true => None,
            false => judged.commissioned.refusal(&config),
        };
        let refusal = refusal.map(refused(Code::NotCommissioned));
        let uncertified = || certificate::refusal(&config).map(refused(Code::File));
        let refusal = refusal.or_else(uncertified).or_else(|| {
            let config = match tuned {
                Some(tuned) => config.with_tuning(tuned.gain, tuned.wanted_point_distance),
                None => config,
            };
            let config = for_the_next_drive(config, &snapshot);
            infeasibility(&config, stand, longest).map(refused(Code::NotFeasible))
        });
        (number, refusal)
    });
    let judgement = judgement.await;
    let (number, refusal) = judgement.map_err(|error| Refused::new(Code::Other, error))?;
    if let Some(refusal) = refusal {
        return Err(refusal);
    }
    // From here to the request nothing is waited for: no other client comes between.
    if daemon.drives.stops() != stops {
        let why = "a disarm or a stop has come meanwhile";
        return Err(cannot(Code::Superseded, why));
    }
    if daemon.reconfigurer.published().view.number != number {
        let why = "the configuration has changed meanwhile; arm again";
        return Err(cannot(Code::Superseded, why));
    }
    ready(daemon)?;
    if start_ns.is_some_and(|start_ns| start_ns <= monotonic_ns()) {
        let why = "start_ns has passed meanwhile; give a later one";
        return Err(cannot(Code::Superseded, why));
    }
    let ticket = daemon.drives.next();
    let arm = |arming| ControlRequest::Pilot(PilotRequest::Arm(arming));
    let request = match (attendance, start_ns) {
        (_, Some(start_ns)) => ControlRequest::ArmAt(start_ns),
        (Attendance::Unattended, None) => arm(Arming::Unattended),
        (Attendance::Hold | Attendance::Timed(_), None) => arm(Arming::Held),
    };
    ticket.pass(daemon, request)?;
    Ok((ticket, DriveWatch::new(daemon)))
}

/// Why the car is not armed.
fn cannot(code: Code, why: &str) -> Refused {
    Refused::new(code, format_args!("can't arm: {why}"))
}

/// Checks that the pilot can be armed now, and that no other client has just asked for it.
fn ready(daemon: &DaemonHandle) -> Result<(), Refused> {
    let snapshot = daemon.snapshot();
    if snapshot.mode() != Mode::Ready {
        return Err(not_ready(&snapshot));
    }
    alone(daemon, &snapshot)
}

/// Checks that no other client has just asked to arm.
fn alone(daemon: &DaemonHandle, snapshot: &Snapshot) -> Result<(), Refused> {
    if daemon.drives.is_open(snapshot) {
        return Err(cannot(Code::OtherClient, "another client has just armed"));
    }
    Ok(())
}

/// Passes a request to jog on. There is nothing to judge: poses, geofence and reference do not
/// matter.
pub(super) fn begin_jogging(daemon: &DaemonHandle) -> Result<(Ticket, DriveWatch), Refused> {
    let snapshot = daemon.snapshot();
    if !matches!(snapshot.mode(), Mode::Idle | Mode::Ready) {
        return Err(cannot_arm(&snapshot, snapshot.mode(), snapshot.reason()));
    }
    alone(daemon, &snapshot)?;
    let ticket = daemon.drives.next();
    ticket.push(daemon, PilotRequest::Arm(Arming::Jog))?;
    Ok((ticket, DriveWatch::new(daemon)))
}

/// Renews a drive until `time` after it began to drive, then ends it.
async fn renew(ticket: Ticket, daemon: DaemonHandle, time: Duration) {
    let mut watch = DriveWatch::new(&daemon);
    let mut driving_since: Option<Instant> = None;
    let mut renewals = interval(RENEWAL);
    renewals.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            progress = watch.next(&daemon) => {
                match progress {
                    Progress::Arming => {}
                    Progress::Driving(_) => {
                        driving_since.get_or_insert_with(Instant::now);
                    }
                    Progress::Refused(_) | Progress::Ended(..) => return,
                }
                continue;
            }
            _ = renewals.tick() => {}
        }
        if driving_since.is_some_and(|since| since.elapsed() >= time) {
            // A stalled control thread stops the car by itself.
            let _ = ticket.push(&daemon, PilotRequest::TimeUp);
            return;
        }
        if ticket.push(&daemon, PilotRequest::Hold).is_err() {
            return;
        }
    }
}

/// Where the car stands by its estimate; `None` without one.
pub(super) fn stand(snapshot: &Snapshot) -> Option<Stand> {
    let estimate = snapshot.output()?.estimate?;
    Some(Stand {
        x_m: estimate.position.x,
        y_m: estimate.position.y,
        yaw_rad: estimate.yaw,
    })
}

/// The configuration with which the next drive begins: a proved one has its first metre behind it.
fn for_the_next_drive(mut config: Config, snapshot: &Snapshot) -> Config {
    config.supervisor.prove_first_metre &= snapshot.latest.proved != Some(true);
    config
}

/// Why the car can't drive its reference from there, for this time at most; `None` if it can.
///
/// It takes 10 to 300 ms of a processor, and with a governor up to some seconds, on a thread that
/// nothing waits for but the client that asked.
fn infeasibility(
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
    let impossible = |finding: &&Finding| finding.severity == Severity::Impossible;
    let reasons = findings.iter().filter(impossible);
    let reasons: Vec<String> = reasons.map(ToString::to_string).collect();
    Some(reasons.join("; "))
}

/// What should be known about a reference that is in force, in one line each.
pub(super) fn warnings(config: Config, snapshot: &Snapshot) -> Vec<String> {
    let text = |finding: &Finding| match finding.severity {
        Severity::Warning => finding.to_string(),
        Severity::Impossible => format!("{}: {finding}", finding.severity.name()),
    };
    let config = for_the_next_drive(config, snapshot);
    match judge_reference(&config, stand(snapshot), None) {
        Ok(judgement) => judgement.findings.iter().map(text).collect(),
        Err(error) => vec![error.to_string()],
    }
}
