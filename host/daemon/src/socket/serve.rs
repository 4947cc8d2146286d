//! What clients say, and what they are answered.

use core::fmt;
use std::{io, time::Duration};

use serde_json::{Value, json};
use singletrack_core::{config::ReferenceSection, control_loop::ControlRequest};
use singletrack_pilot::{Mode, Reason, Request};
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

use super::{
    CLIENTS, SOCKET_VERSION,
    command::{Command, Question},
};
use crate::{clock::monotonic_ns, daemon::View};

/// The longest line that is read.
const LONGEST_LINE: u64 = 4_096;

/// How long a client that finds no place may take to say what it wants.
const REFUSAL_PATIENCE: Duration = Duration::from_secs(1);

/// How long an arm command waits for the car to drive.
const ARM_PATIENCE: Duration = Duration::from_secs(2);

/// How often it looks.
const ARM_LOOK: Duration = Duration::from_millis(5);

/// However many are connected, a stop is heard.
pub(super) async fn refuse(stream: UnixStream, view: &View) -> io::Result<()> {
    let (read, mut write) = stream.into_split();
    let mut line = Vec::new();
    let mut read = BufReader::new(read).take(LONGEST_LINE);
    let heard = tokio::time::timeout(REFUSAL_PATIENCE, read.read_until(b'\n', &mut line)).await;
    let answer = match (heard, Command::parse(&line, monotonic_ns())) {
        (Ok(Ok(_)), Ok(Command::Ask(question @ (Question::Stop | Question::Disarm)))) => {
            answer(question, view).await
        }
        _ => failure(format!("{CLIENTS} clients are connected; close one")),
    };
    send(&mut write, &answer).await
}

pub(super) async fn serve(stream: UnixStream, view: &View) -> io::Result<()> {
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
            // Answered only after its end: a connection that is closed while its
            // client still writes loses the answer.
            skip_line(&mut read).await?;
            let answer = failure(format!("a line is at most {LONGEST_LINE} bytes long"));
            send(&mut write, &answer).await?;
            continue;
        }
        match Command::parse(&line, monotonic_ns()) {
            Ok(Command::Watch { topics }) => {
                let mut rest = [0];
                // A watcher says nothing more; it may be gone long before there
                // is something to tell it.
                return tokio::select! {
                    watched = watch(&mut write, view, &topics) => watched,
                    gone = read.read(&mut rest) => gone.map(drop),
                };
            }
            Ok(Command::Ask(question)) => {
                send(&mut write, &answer(question, view).await).await?;
            }
            Ok(Command::SetReference(reference)) => {
                send(&mut write, &set_reference(reference, view).await).await?;
            }
            Ok(Command::Setpoint(setpoint)) => {
                if view.reconfigurer.takes_setpoints() {
                    view.setpoints.send(&setpoint);
                } else {
                    let error = "set-points are not obeyed: reference.kind is not \"external\"; \
                                 change it with set-reference or in the configuration";
                    send(&mut write, &failure(error)).await?;
                }
            }
            Err(error) => send(&mut write, &failure(error)).await?,
        }
    }
}

/// Reads up to the end of the line, or of what there is, and keeps nothing.
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

async fn answer(question: Question, view: &View) -> Value {
    let asked = |request| {
        let pushed = view.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    };
    let done = match question {
        Question::Status => {
            return json!({
                "version": SOCKET_VERSION,
                "ok": true,
                "status": view.snapshot().to_json(),
            });
        }
        Question::Arm => arm(view).await,
        Question::Disarm => asked(Request::Disarm),
        Question::Stop => asked(Request::EmergencyStop),
    };
    match done {
        // No mode: a disarm or a stop shows in it only after the next tick.
        Ok(()) => json!({ "version": SOCKET_VERSION, "ok": true }),
        Err(error) => failure(error),
    }
}

async fn set_reference(reference: ReferenceSection, view: &View) -> Value {
    let reconfigurer = view.reconfigurer.clone();
    // It reads files and waits for the control thread; the other clients, who may
    // want to say stop, do not wait for it.
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

/// Asks for a drive and waits for it.
async fn arm(view: &View) -> Result<(), String> {
    let before = view.snapshot();
    if before.mode() != Mode::Ready {
        return Err(cannot_arm(before.mode(), before.reason()));
    }
    view.requests
        .push(ControlRequest::Pilot(Request::Arm))
        .map_err(|error| error.to_string())?;
    let asked_ns = monotonic_ns();
    let looks = ARM_PATIENCE.as_millis() / ARM_LOOK.as_millis();
    for _ in 0..looks {
        tokio::time::sleep(ARM_LOOK).await;
        if let Some(outcome) = view
            .snapshot()
            .tick
            .and_then(|tick| arm_outcome(asked_ns, tick.start_ns, tick.mode, tick.reason))
        {
            return outcome;
        }
    }
    Err("can't arm: the control thread does not answer".to_owned())
}

/// What a tick says about a request to arm; none while that is open.
fn arm_outcome(
    asked_ns: u64,
    tick_start_ns: u64,
    mode: Mode,
    reason: Option<Reason>,
) -> Option<Result<(), String>> {
    // A tick that began before may not have seen the request.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving => Some(Ok(())),
        Mode::Arming => None,
        // The attempt has ended, even if nobody was looking while it was made.
        mode => Some(Err(cannot_arm(mode, reason))),
    }
}

fn cannot_arm(mode: Mode, reason: Option<Reason>) -> String {
    match reason {
        Some(reason) => format!("can't arm: mode {mode}: {reason}"),
        None => format!("can't arm: mode {mode}"),
    }
}

async fn watch(write: &mut OwnedWriteHalf, view: &View, topics: &[Topic]) -> io::Result<()> {
    let mut entries = view.board.watchers.subscribe();
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
    fn an_arm_is_answered_by_the_first_tick_after_it_that_is_not_arming() {
        let outcome = |start_ns, mode, reason| arm_outcome(100, start_ns, mode, reason);
        assert_eq!(outcome(100, Mode::Ready, None), None);
        assert_eq!(outcome(101, Mode::Arming, None), None);
        assert_eq!(outcome(101, Mode::Driving, None), Some(Ok(())));
        for (mode, reason, words) in [
            (Mode::Ready, Reason::BoardRefused, "ready: board-refused"),
            (Mode::Idle, Reason::ImuSilent, "idle: imu-silent"),
            (Mode::Disconnected, Reason::LinkDown, "link-down"),
        ] {
            let error = outcome(101, mode, Some(reason)).unwrap().unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
