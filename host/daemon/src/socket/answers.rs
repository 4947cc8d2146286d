//! The answers to commands that a line asks for and that hold no connection.

use core::fmt::Display;

use singletrack_api::{Answer, Clocks};
use singletrack_core::{
    ControlRequest,
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
    reconfigure::ChangeError,
};
use singletrack_pilot::{Mode, PilotRequest, Reason};
use tokio::task::spawn_blocking;

use super::{
    command::{ParseError, SimpleRequest},
    setpoint::reject,
};
use crate::{
    clock::{monotonic_ns, wall_ns},
    commissioned_file::subject,
    handle::DaemonHandle,
    judgement,
    snapshot::Snapshot,
};

/// The answer to a line that is no command. A rejected set-point is counted.
pub(super) fn no_command(daemon: &DaemonHandle, error: &ParseError) -> Answer {
    match &error.rejected {
        Some(rejected) => reject(daemon, rejected),
        None => Answer::failure(error),
    }
}

pub(super) async fn answer(request: SimpleRequest, daemon: &DaemonHandle) -> Answer {
    let push = |request| {
        let pushed = daemon.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    };
    if request != SimpleRequest::Status {
        daemon.drives.stop();
    }
    let stuck = daemon.control.is_stuck(monotonic_ns());
    // No mode in an answer: the effect of a request shows after the next tick only.
    let done = match request {
        SimpleRequest::Status => {
            return Answer {
                status: Some(daemon.snapshot().status()),
                ..Answer::done()
            };
        }
        SimpleRequest::Carried => push(PilotRequest::Carried),
        SimpleRequest::Disarm => {
            match (push(PilotRequest::Disarm), disarm_note(&daemon.snapshot())) {
                (Ok(()), Some(note)) if !stuck => {
                    return Answer {
                        note: Some(note.into()),
                        ..Answer::done()
                    };
                }
                (result, _) => result,
            }
        }
        SimpleRequest::Halt => push(PilotRequest::Halt),
        SimpleRequest::Stop => push(PilotRequest::EmergencyStop),
    };
    match done {
        Ok(()) if stuck => Answer::failure(
            "the control thread is stuck: it does not see this. The board stops the car by itself, \
             95 ms after the last command",
        ),
        Ok(()) => Answer::done(),
        Err(error) => Answer::failure(error),
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
    match daemon.reconfigurer.text() {
        (number, Some(toml)) => Answer {
            configuration: Some(number),
            toml: Some(toml.to_string()),
            ..Answer::done()
        },
        (_, None) => Answer::failure("the configuration has a path that is not UTF-8"),
    }
}

/// Reads the configuration's file again, as SIGHUP does.
pub(super) async fn reload(daemon: &DaemonHandle) -> Answer {
    let Some(path) = daemon.config_path.clone() else {
        return Answer::failure("this daemon was not started with a file");
    };
    let changing = daemon.clone();
    let reloaded = on_own_thread(move || changing.reconfigurer.reload(&path)).await;
    reloaded.map_or_else(Answer::failure, |number| Answer {
        configuration: Some(number),
        ..Answer::done()
    })
}

/// Does what reads files, waits for the control thread or judges on a thread of its own, where it
/// does not delay a stop of another client.
async fn on_own_thread<T: Send + 'static, E: Display + Send + 'static>(
    work: impl FnOnce() -> Result<T, E> + Send + 'static,
) -> Result<T, String> {
    match spawn_blocking(work).await {
        Ok(result) => result.map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    }
}

pub(super) async fn set_reference(reference: ReferenceSection, daemon: &DaemonHandle) -> Answer {
    let changing = daemon.clone();
    let changed = on_own_thread(move || {
        let number = changing
            .reconfigurer
            .set_reference(reference, changing.config_path.as_deref())?;
        let (_, config) = changing.reconfigurer.in_force();
        let warnings = judgement::warnings(&config, judgement::stand(&changing.snapshot()));
        Ok::<_, ChangeError>((number, warnings))
    })
    .await;
    changed.map_or_else(Answer::failure, |(number, warnings)| Answer {
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
        let subject = subject(&config).map_err(|error| error.to_string())?;
        if config.supervisor.require_calibration
            && !uncalibrated
            && let Some(missing) = noting
                .commissioned
                .missing_before(procedure, result, subject)
        {
            return Err(missing.to_string());
        }
        let noted = noting.commissioned.note(procedure, result, subject);
        noted.map_err(|error| {
            format!(
                "can't be kept in {}: {error}",
                config.state.directory.display()
            )
        })
    })
    .await;
    noted.map_or_else(Answer::failure, |()| Answer::done())
}
