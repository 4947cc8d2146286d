//! The answers to commands that a line asks for and that hold no connection.

use std::time::Duration;

use serde_json::json;
use singletrack_api::{Answer, Clocks, Code, Refused};
use singletrack_core::{
    ControlRequest,
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
    reconfigure::ChangeError,
};
use singletrack_pilot::{Mode, PilotRequest, Reason, Tuned, Tuning};
use tokio::{task::spawn_blocking, time::timeout};

use super::{arm::warnings, command::ParseError, drives::next_tick, setpoint::reject};
use crate::{
    clock::{monotonic_ns, wall_ns},
    commissioned_file::subject,
    handle::{DaemonHandle, Snapshot, tuning_of},
};

/// The answer to a line that is no command. A rejected set-point is counted.
pub(super) fn no_command(daemon: &DaemonHandle, error: &ParseError) -> Answer {
    match error {
        ParseError::Rejected(rejected) => reject(daemon, rejected),
        ParseError::Text(text) => Answer::failure(Code::Invalid, text),
    }
}

/// The status of daemon, board and figures.
pub(super) fn status(daemon: &DaemonHandle) -> Answer {
    Answer {
        status: Some(daemon.snapshot().status()),
        ..Answer::done()
    }
}

/// Passes a request on that ends a drive. There is no mode in the answer: its effect shows after the
/// next tick only.
pub(super) fn end(request: PilotRequest, daemon: &DaemonHandle) -> Answer {
    daemon.drives.stop();
    let stuck = daemon.control.is_stuck(monotonic_ns());
    if let Err(error) = daemon.requests.push(ControlRequest::Pilot(request)) {
        return Answer::failure(Code::Stalled, error);
    }
    if stuck {
        return Answer::failure(
            Code::Stalled,
            "the control thread is stuck: it does not see this. The board stops the car by itself, \
             95 ms after the last command",
        );
    }
    let note = (request == PilotRequest::Disarm)
        .then(|| disarm_note(&daemon.snapshot()))
        .flatten();
    Answer {
        note: note.map(Into::into),
        ..Answer::done()
    }
}

/// What a disarm does not change, if an emergency stop is in force.
fn disarm_note(snapshot: &Snapshot) -> Option<&'static str> {
    let stopped = matches!(snapshot.mode(), Mode::Fault | Mode::Disconnected)
        && snapshot.reason() == Some(Reason::EmergencyStop);
    stopped.then_some("an emergency stop is in force: the board stays stopped until it is reset")
}

/// The clocks now.
pub(super) fn clocks() -> Answer {
    Answer {
        clocks: Some(Clocks {
            monotonic_ns: monotonic_ns(),
            wall_ns: wall_ns(),
        }),
        ..Answer::done()
    }
}

/// The configuration in force.
pub(super) fn configuration(daemon: &DaemonHandle) -> Answer {
    let published = daemon.reconfigurer.published();
    match &published.toml {
        Some(toml) => Answer {
            configuration: Some(published.view.number),
            toml: Some(toml.clone()),
            ..Answer::done()
        },
        None => Answer::failure(Code::File, "the configuration has a path that is not UTF-8"),
    }
}

/// Reads the configuration's file again, as SIGHUP does.
pub(super) async fn reload(daemon: &DaemonHandle) -> Answer {
    let Some(path) = daemon.config_path.clone() else {
        return Answer::failure(Code::File, "this daemon was not started with a file");
    };
    let changing = daemon.clone();
    let reloaded =
        on_own_thread(move || changing.reconfigurer.reload(&path).map_err(change_refused)).await;
    reloaded.map_or_else(Answer::refusal, |number| Answer {
        configuration: Some(number),
        ..Answer::done()
    })
}

/// Does what reads files, waits for the control thread or judges on a thread of its own, where it
/// does not delay a stop of another client.
async fn on_own_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Refused> + Send + 'static,
) -> Result<T, Refused> {
    let done = spawn_blocking(work).await;
    done.unwrap_or_else(|error| Err(Refused::new(Code::Other, error)))
}

/// Why a change of the configuration is refused.
fn change_refused(error: ChangeError) -> Refused {
    let code = match &error {
        ChangeError::Restart(_) => Code::NeedsRestart,
        ChangeError::Refused(_) => Code::NotReady,
        ChangeError::Stalled(_) => Code::Stalled,
        ChangeError::Foreign { .. } => Code::File,
        ChangeError::Config(_) | ChangeError::Path(_) | ChangeError::RelativePath(_) => {
            Code::Invalid
        }
    };
    Refused::new(code, error)
}

pub(super) async fn set_reference(reference: ReferenceSection, daemon: &DaemonHandle) -> Answer {
    let changing = daemon.clone();
    let changed = on_own_thread(move || {
        let number = changing
            .reconfigurer
            .set_reference(reference, changing.config_path.as_deref())
            .map_err(change_refused)?;
        let (_, config) = changing.reconfigurer.in_force();
        let warnings = warnings(config, &changing.snapshot());
        Ok((number, warnings))
    })
    .await;
    changed.map_or_else(Answer::refusal, |(number, warnings)| Answer {
        configuration: Some(number),
        warnings,
        ..Answer::done()
    })
}

/// Keeps the state of a procedure with the configuration in force. One that begins, or goes on, is
/// refused as an `arm` is if an earlier one has not passed.
pub(super) async fn commissioned(
    procedure: Procedure,
    result: ProcedureResult,
    uncalibrated: bool,
    daemon: &DaemonHandle,
) -> Answer {
    let noting = daemon.clone();
    // It waits for a change that is under way, and for the disk.
    let noted = on_own_thread(move || {
        let (_, config) = noting.reconfigurer.in_force();
        let subject = subject(&config).map_err(|error| Refused::new(Code::File, error))?;
        if config.supervisor.require_calibration
            && !uncalibrated
            && let Some(missing) = noting
                .commissioned
                .missing_before(procedure, result, subject)
        {
            return Err(Refused::new(Code::NotCommissioned, missing));
        }
        let noted = noting.commissioned.note(procedure, result, subject);
        noted.map_err(|error| {
            let directory = config.state.directory.display();
            Refused::new(
                Code::File,
                format_args!("can't be kept in {directory}: {error}"),
            )
        })
    })
    .await;
    noted.map_or_else(Answer::refusal, |()| Answer::done())
}

/// The longest wait for the tick that takes the values: much less than the time in which a client
/// must renew the drive that it holds.
const TUNING_TIMEOUT: Duration = Duration::from_millis(200);

/// Tunes the pilot, and says what is in force then.
pub(super) async fn tune(tuning: Tuning, daemon: &DaemonHandle) -> Answer {
    match try_tune(tuning, daemon).await {
        Ok(tuned) => Answer {
            tuning: Some(tuning_of(&tuned)),
            ..Answer::done()
        },
        Err(Refused { code, text }) => Answer::failure(code, format!("can't tune: {text}")),
    }
}

async fn try_tune(tuning: Tuning, daemon: &DaemonHandle) -> Result<Tuned, Refused> {
    let latest = daemon.status.latest().tick.clone();
    let before = latest.and_then(|tick| tick.output.tuned);
    let rule = daemon.reconfigurer.published().config.tuning_rule();
    rule.check(&tuning, before.as_ref())
        .map_err(|error| Refused::new(Code::OutOfRange, error))?;
    let mut ticks = daemon.status.ticks.subscribe();
    let asked_ns = monotonic_ns();
    daemon.tunings.send(tuning);
    let taken = async {
        loop {
            let tick = next_tick(&mut ticks).await;
            // A tick that began before the request may not have seen it.
            if tick.start_ns > asked_ns {
                break tick.output.tuned;
            }
        }
    };
    let tuned = timeout(TUNING_TIMEOUT, taken)
        .await
        .map_err(|_| Refused::new(Code::Stalled, "the control thread is stalled"))?
        .filter(|tuned| tuned.has(&tuning));
    let tuned = tuned.ok_or_else(|| {
        Refused::new(
            Code::Superseded,
            "another client or another configuration has come meanwhile; ask again",
        )
    })?;
    tracing::info!("tuned: {}", json!(tuning_of(&tuned)));
    Ok(tuned)
}
