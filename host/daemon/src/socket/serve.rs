//! Serves one client: reads its lines and answers them.

use core::fmt;
use std::{io, time::Duration};

use serde_json::{Value, json};
use singletrack_core::{ControlRequest, config::ReferenceSection};
use singletrack_pilot::{Mode, PilotRequest, Reason};
use singletrack_record::Topic;
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    net::{
        UnixStream,
        unix::{OwnedReadHalf, OwnedWriteHalf},
    },
    sync::broadcast::error::RecvError,
    task::spawn_blocking,
};

use super::command::{Command, Question, SOCKET_VERSION};
use crate::{clock::monotonic_ns, handle::DaemonHandle, snapshot::Snapshot};

/// The largest number of clients at a time.
pub(super) const CLIENTS: usize = 32;

/// The longest line, in bytes.
const LONGEST_LINE: u64 = 4_096;

/// The longest wait for the first line of a client beyond [`CLIENTS`].
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// The longest wait of an arm command for its outcome.
const ARM_TIMEOUT: Duration = Duration::from_secs(2);

/// Interval at which an arm command polls for its outcome.
const ARM_POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Serves a client beyond [`CLIENTS`]: only a stop or a disarm is obeyed.
pub(super) async fn refuse(stream: UnixStream, daemon: &DaemonHandle) -> io::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut line = Vec::new();
    let mut read = BufReader::new(read).take(LONGEST_LINE);
    let first_line = tokio::time::timeout(REFUSAL_TIMEOUT, read.read_until(b'\n', &mut line)).await;
    let answer = match (first_line, Command::parse(&line, monotonic_ns())) {
        (Ok(Ok(_)), Ok(Command::Ask(question @ (Question::Stop | Question::Disarm)))) => {
            answer(question, daemon).await
        }
        _ => failure(format!("{CLIENTS} clients are connected; close one")),
    };
    send(&mut write, &answer).await
}

pub(super) async fn serve(stream: UnixStream, daemon: &DaemonHandle) -> io::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut read = BufReader::new(read);
    let mut line = Vec::new();
    loop {
        line.clear();
        let count = (&mut read)
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line)
            .await?;
        if count == 0 {
            return Ok(());
        }
        if !line.ends_with(b"\n") && count as u64 == LONGEST_LINE {
            // The rest is read first: a client that is still writing would not read the
            // answer.
            skip_line(&mut read).await?;
            let answer = failure(format!("a line is at most {LONGEST_LINE} bytes long"));
            send(&mut write, &answer).await?;
            continue;
        }
        match Command::parse(&line, monotonic_ns()) {
            Ok(Command::Watch { topics }) => {
                let mut rest = [0];
                // A watcher sends no more lines. Reading detects that it has disconnected, also
                // while there are no entries.
                return tokio::select! {
                    result = watch(&mut write, daemon, &topics) => result,
                    closed = read.read(&mut rest) => closed.map(drop),
                };
            }
            Ok(Command::Ask(question)) => {
                send(&mut write, &answer(question, daemon).await).await?;
            }
            Ok(Command::SetReference(reference)) => {
                send(&mut write, &set_reference(reference, daemon).await).await?;
            }
            Ok(Command::Setpoint(setpoint)) => {
                if daemon.reconfigurer.takes_setpoints() {
                    daemon.setpoints.send(&setpoint);
                } else {
                    let error = "set-points are not in use: reference.kind is not \"external\"; \
                                 change it with set-reference or in the configuration";
                    send(&mut write, &failure(error)).await?;
                }
            }
            Err(error) => send(&mut write, &failure(error)).await?,
        }
    }
}

/// Reads and discards up to the end of the line or of the stream.
async fn skip_line(read: &mut BufReader<OwnedReadHalf>) -> io::Result<()> {
    loop {
        let bytes = read.fill_buf().await?;
        let end = bytes.iter().position(|&byte| byte == b'\n');
        let count = end.map_or(bytes.len(), |end| end + 1);
        read.consume(count);
        if end.is_some() || count == 0 {
            return Ok(());
        }
    }
}

async fn send(write: &mut OwnedWriteHalf, answer: &Value) -> io::Result<()> {
    write.write_all(format!("{answer}\n").as_bytes()).await
}

fn failure(error: impl fmt::Display) -> Value {
    json!({ "version": SOCKET_VERSION, "ok": false, "error": error.to_string() })
}

async fn answer(question: Question, daemon: &DaemonHandle) -> Value {
    let push = |request| {
        let pushed = daemon.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    };
    // No mode in an answer: the effect of a request shows after the next tick only.
    let done = match question {
        Question::Status => {
            return json!({
                "version": SOCKET_VERSION,
                "ok": true,
                "status": daemon.snapshot().to_json(),
            });
        }
        Question::Arm => arm(daemon).await,
        Question::Disarm => match (push(PilotRequest::Disarm), disarm_note(&daemon.snapshot())) {
            (Ok(()), Some(note)) => {
                return json!({ "version": SOCKET_VERSION, "ok": true, "note": note });
            }
            (result, _) => result,
        },
        Question::Stop => push(PilotRequest::EmergencyStop),
    };
    match done {
        Ok(()) => json!({ "version": SOCKET_VERSION, "ok": true }),
        Err(error) => failure(error),
    }
}

/// What a disarm does not change, if an emergency stop is in force.
fn disarm_note(snapshot: &Snapshot) -> Option<&'static str> {
    let stopped = matches!(snapshot.mode(), Mode::Fault | Mode::Disconnected)
        && snapshot.reason() == Some(Reason::EmergencyStop);
    stopped.then_some("an emergency stop is in force: the board stays stopped until it is reset")
}

async fn set_reference(reference: ReferenceSection, daemon: &DaemonHandle) -> Value {
    let reconfigurer = daemon.reconfigurer.clone();
    // It reads files and waits for the control thread. On a thread of its own, it does not
    // delay a stop of another client.
    let changed = spawn_blocking(move || reconfigurer.set_reference(reference)).await;
    match changed {
        Ok(Ok(number)) => json!({
            "version": SOCKET_VERSION,
            "ok": true,
            "configuration": number,
        }),
        Ok(Err(error)) => failure(error),
        Err(error) => failure(error),
    }
}

/// Requests to arm and waits for the outcome.
async fn arm(daemon: &DaemonHandle) -> Result<(), String> {
    let before = daemon.snapshot();
    if before.mode() != Mode::Ready {
        return Err(not_ready(before.mode(), before.reason()));
    }
    daemon
        .requests
        .push(ControlRequest::Pilot(PilotRequest::Arm))
        .map_err(|error| error.to_string())?;
    let asked_ns = monotonic_ns();
    let polls = ARM_TIMEOUT.as_millis() / ARM_POLL_INTERVAL.as_millis();
    for _ in 0..polls {
        tokio::time::sleep(ARM_POLL_INTERVAL).await;
        if let Some(outcome) = daemon
            .snapshot()
            .tick
            .and_then(|tick| arm_outcome(asked_ns, tick.start_ns, tick.mode, tick.reason))
        {
            return outcome;
        }
    }
    Err("can't arm: the control thread does not answer".to_owned())
}

/// The outcome of a request to arm by a tick; `None` while it is open.
fn arm_outcome(
    asked_ns: u64,
    tick_start_ns: u64,
    mode: Mode,
    reason: Option<Reason>,
) -> Option<Result<(), String>> {
    // A tick that began before the request may not have seen it.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving => Some(Ok(())),
        Mode::Arming => None,
        // The attempt has ended, even if no poll saw it in progress.
        mode => Some(Err(cannot_arm(mode, reason))),
    }
}

/// Why a pilot that is not ready can't be armed.
///
/// A pilot that settles after a drive still shows the reason of its end, which is not what
/// an arm request fails on.
fn not_ready(mode: Mode, reason: Option<Reason>) -> String {
    match (mode, reason) {
        (
            Mode::Idle,
            Some(
                Reason::Requested
                | Reason::ReferenceFinished
                | Reason::BoardRefused
                | Reason::BoardTimeout
                | Reason::MotorSpeedMismatch
                | Reason::Overspeed
                | Reason::BlindTooFar
                | Reason::LawSingular,
            ),
        ) => format!(
            "{}: car and estimate are settling; try again in a second",
            cannot_arm(mode, None)
        ),
        _ => cannot_arm(mode, reason),
    }
}

fn cannot_arm(mode: Mode, reason: Option<Reason>) -> String {
    match reason {
        Some(reason) => format!("can't arm: mode {mode}: {reason}"),
        None => format!("can't arm: mode {mode}"),
    }
}

async fn watch(
    write: &mut OwnedWriteHalf,
    daemon: &DaemonHandle,
    topics: &[Topic],
) -> io::Result<()> {
    let mut entries = daemon.status.watchers.subscribe();
    send(write, &json!({ "version": SOCKET_VERSION, "ok": true })).await?;
    loop {
        match entries.recv().await {
            Ok((topic, line)) => {
                if topics.is_empty() || topics.contains(&topic) {
                    write.write_all(line.as_bytes()).await?;
                    write.write_all(b"\n").await?;
                }
            }
            Err(RecvError::Lagged(missed)) => {
                send(
                    write,
                    &json!({ "version": SOCKET_VERSION, "missed": missed }),
                )
                .await?;
            }
            Err(RecvError::Closed) => return Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_is_answered_by_the_first_later_tick_that_is_not_arming() {
        let outcome = |start_ns, mode, reason| arm_outcome(100, start_ns, mode, reason);
        assert_eq!(outcome(100, Mode::Ready, None), None);
        assert_eq!(outcome(101, Mode::Arming, None), None);
        assert_eq!(outcome(101, Mode::Driving, None), Some(Ok(())));
        for (mode, reason, part) in [
            (Mode::Ready, Reason::BoardRefused, "ready: board-refused"),
            (Mode::Idle, Reason::ImuSilent, "idle: imu-silent"),
            (Mode::Disconnected, Reason::LinkDown, "link-down"),
        ] {
            let error = outcome(101, mode, Some(reason)).unwrap().unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn an_arm_of_a_settling_pilot_does_not_name_the_reason_of_the_last_stop() {
        let error = not_ready(Mode::Idle, Some(Reason::Requested));
        assert!(
            error.starts_with("can't arm: mode idle: ") && error.contains("settling"),
            "{error}"
        );
        for (mode, reason) in [
            (Mode::Idle, Reason::NoPose),
            (Mode::Stopping, Reason::Requested),
        ] {
            assert_eq!(
                not_ready(mode, Some(reason)),
                cannot_arm(mode, Some(reason))
            );
        }
    }
}
