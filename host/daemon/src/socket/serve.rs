//! Serves one client: reads its lines and answers them.

use std::{io, time::Duration};

use serde::Serialize;
use singletrack_access::Place;
use singletrack_api::{Answer, Clocks, Reply, SOCKET_VERSION};
use singletrack_core::{
    ControlRequest,
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
    reasons::Why,
    reconfigure::ChangeError,
};
use singletrack_pilot::{Mode, PilotRequest, Reason};
use singletrack_record::{Channel, Topic};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    sync::broadcast::error::RecvError,
    task::{spawn_blocking, yield_now},
    time::timeout,
};

use super::{
    arm::arm,
    attend::{hold, hung_up, jog},
    command::{Attendance, Command, ParseError, SimpleRequest},
    setpoint::{SetpointStream, reject},
    stream::{Connection, ReadHalf, WriteHalf, limit_send_buffer},
    tune::tune,
};
use crate::{
    clock::{monotonic_ns, wall_ns},
    commissioned_file::subject,
    handle::DaemonHandle,
    judgement,
    shared_status::WATCHERS,
    snapshot::Snapshot,
};

/// The largest number of clients at a time.
pub(super) const CLIENTS: usize = 32;

/// The longest line, in bytes: a trajectory of 100 points with all their digits.
pub(super) const LONGEST_LINE: u64 = 16_384;

/// The largest number of clients beyond [`CLIENTS`] whose first line is waited for.
pub(super) const WAITING: usize = 64;

/// The longest wait for it.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// Bytes of the kernel's buffer of a reader of states; the kernel doubles it. It holds some six lines,
/// which a reader that is slow gets before it learns how many it has missed.
const STATE_BUFFER: usize = 4_096;

/// A control thread whose last tick is older is stuck.
const TICK_TIMEOUT: Duration = Duration::from_millis(500);

/// Serves a client beyond [`CLIENTS`]: only what ends a drive is obeyed.
pub(super) async fn refuse(
    connection: Connection,
    daemon: &DaemonHandle,
    mut place: Place,
) -> io::Result<()> {
    let Connection { read, mut write } = connection;
    let mut line = Vec::new();
    let mut read = read.take(LONGEST_LINE);
    let first_line = timeout(REFUSAL_TIMEOUT, read.read_until(b'\n', &mut line));
    let first_line = place.until_lost(first_line).await;
    let answer = match (first_line, Command::parse(&line, monotonic_ns())) {
        (
            Some(Ok(Ok(_))),
            Ok(Command::Simple(
                request @ (SimpleRequest::Stop
                | SimpleRequest::Disarm
                | SimpleRequest::Halt
                | SimpleRequest::Carried),
            )),
        ) => answer(request, daemon).await,
        _ => Answer::failure(format!("{CLIENTS} clients are connected; close one")),
    };
    send(&mut write, &answer).await
}

pub(super) async fn serve(connection: Connection, daemon: &DaemonHandle) -> io::Result<()> {
    let Connection {
        mut read,
        mut write,
    } = connection;
    let mut line = Vec::new();
    let mut setpoints = SetpointStream::default();
    loop {
        line.clear();
        // One line, and then a line of each other client: none that sends without a pause delays the
        // stop of another one by more.
        yield_now().await;
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
            let answer = Answer::failure(format!("a line is at most {LONGEST_LINE} bytes long"));
            send(&mut write, &answer).await?;
            continue;
        }
        let command = Command::parse(&line, monotonic_ns());
        let watches = matches!(
            command,
            Ok(Command::Watch { .. } | Command::Messages { .. } | Command::WatchState)
        );
        let place = watches.then(|| daemon.status.watch_places.try_acquire());
        if let Some(Err(_)) = place {
            let error = format!("{WATCHERS} clients watch; close one: the others may command");
            send(&mut write, &Answer::failure(error)).await?;
            continue;
        }
        match command {
            Ok(Command::Watch { topics }) => {
                let mut rest = [0];
                // A watcher sends no more lines. Reading detects that it has disconnected, also
                // while there are no entries.
                return tokio::select! {
                    result = watch(&mut write, daemon, &topics) => result,
                    closed = read.read(&mut rest) => closed.map(drop),
                };
            }
            Ok(Command::Messages { channels }) => {
                let mut rest = [0];
                return tokio::select! {
                    result = messages(&mut write, daemon, &channels) => result,
                    closed = read.read(&mut rest) => closed.map(drop),
                };
            }
            Ok(Command::WatchState) => {
                let mut rest = [0];
                return tokio::select! {
                    result = watch_state(&mut write, daemon) => result,
                    closed = read.read(&mut rest) => closed.map(drop),
                };
            }
            Ok(Command::Arm(request)) if request.attendance == Attendance::Hold => {
                if !hold(&mut read, &mut write, daemon, &mut setpoints, request).await? {
                    return Ok(());
                }
            }
            Ok(Command::ArmJog) => {
                if !jog(&mut read, &mut write, daemon, &mut setpoints).await? {
                    return Ok(());
                }
            }
            Ok(Command::Jog(_)) => {
                let error = "jog gives pulses on a connection that jogs: arm first with \
                             {\"command\":\"arm\",\"attendance\":\"hold\",\"jog\":true}";
                send(&mut write, &Answer::failure(error)).await?;
            }
            Ok(Command::Reload) => {
                send(&mut write, &reload(daemon).await).await?;
            }
            Ok(Command::Arm(request)) => {
                // A client that has given up must not be obeyed later.
                let armed = tokio::select! {
                    armed = arm(daemon, request) => armed,
                    () = hung_up(&mut read) => return Ok(()),
                };
                let answer = armed.map_or_else(Answer::failure, |()| Answer::done());
                send(&mut write, &answer).await?;
            }
            Ok(Command::Hold) => {
                let error = "hold renews a drive that this connection armed with the attendance \
                             \"hold\"; there is none";
                send(&mut write, &Answer::failure(error)).await?;
            }
            Ok(Command::Simple(request)) => {
                send(&mut write, &answer(request, daemon).await).await?;
            }
            Ok(Command::Clock) => send(&mut write, &clocks()).await?,
            Ok(Command::Configuration) => send(&mut write, &configuration(daemon)).await?,
            Ok(Command::SetReference(reference)) => {
                send(&mut write, &set_reference(reference, daemon).await).await?;
            }
            Ok(Command::Tune(tuning)) => {
                send(&mut write, &tune(tuning, daemon).await).await?;
            }
            Ok(Command::Commissioned { procedure, result }) => {
                let answer = commissioned(procedure, result, daemon).await;
                send(&mut write, &answer).await?;
            }
            Ok(Command::Setpoint(setpoint)) => {
                if let Some(answer) = setpoints.pass(daemon, &setpoint) {
                    send(&mut write, &answer).await?;
                }
            }
            Err(error) => send(&mut write, &no_command(daemon, &error)).await?,
        }
    }
}

/// The answer to a line that is no command. A rejected set-point is counted.
pub(super) fn no_command(daemon: &DaemonHandle, error: &ParseError) -> Answer {
    match &error.rejected {
        Some(rejected) => reject(daemon, rejected),
        None => Answer::failure(error),
    }
}

/// Reads and discards up to the end of the line or of the stream.
pub(super) async fn skip_line(read: &mut BufReader<ReadHalf>) -> io::Result<()> {
    loop {
        let bytes = read.fill_buf().await?;
        let end = bytes.iter().position(|&byte| byte == b'\n');
        let count = end.map_or(bytes.len(), |end| end + 1);
        read.consume(count);
        if end.is_some() || count == 0 {
            return Ok(());
        }
        yield_now().await;
    }
}

pub(super) async fn send(write: &mut WriteHalf, answer: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    write.write_all(&line).await
}

pub(super) async fn answer(request: SimpleRequest, daemon: &DaemonHandle) -> Answer {
    let push = |request| {
        let pushed = daemon.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    };
    if request != SimpleRequest::Status {
        daemon.drives.stop();
    }
    let stuck = daemon.snapshot().tick.is_some_and(|tick| {
        monotonic_ns().saturating_sub(tick.start_ns) > TICK_TIMEOUT.as_nanos() as u64
    });
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
fn clocks() -> Answer {
    Answer {
        clocks: Some(Clocks {
            monotonic_ns: monotonic_ns(),
            wall_ns: wall_ns(),
        }),
        ..Answer::done()
    }
}

/// The configuration in force.
fn configuration(daemon: &DaemonHandle) -> Answer {
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
async fn reload(daemon: &DaemonHandle) -> Answer {
    let Some(path) = daemon.config_path.clone() else {
        return Answer::failure("this daemon was not started with a file");
    };
    let changing = daemon.clone();
    match spawn_blocking(move || changing.reconfigurer.reload(&path)).await {
        Ok(Ok(number)) => Answer {
            configuration: Some(number),
            ..Answer::done()
        },
        Ok(Err(error)) => Answer::failure(error),
        Err(error) => Answer::failure(error),
    }
}

async fn set_reference(reference: ReferenceSection, daemon: &DaemonHandle) -> Answer {
    let changing = daemon.clone();
    // It reads files, waits for the control thread and judges. On a thread of its own, it does
    // not delay a stop of another client.
    let changed = spawn_blocking(move || {
        let number = changing
            .reconfigurer
            .set_reference(reference, changing.config_path.as_deref())?;
        let (_, config) = changing.reconfigurer.in_force();
        let warnings = judgement::warnings(&config, judgement::stand(&changing.snapshot()));
        Ok::<_, ChangeError>((number, warnings))
    })
    .await;
    match changed {
        Ok(Ok((number, warnings))) => Answer {
            configuration: Some(number),
            warnings,
            ..Answer::done()
        },
        Ok(Err(error)) => Answer::failure(error),
        Err(error) => Answer::failure(error),
    }
}

/// Keeps the state of a procedure with the configuration in force.
async fn commissioned(
    procedure: Procedure,
    result: ProcedureResult,
    daemon: &DaemonHandle,
) -> Answer {
    let noting = daemon.clone();
    // It waits for a change that is under way, and for the disk.
    let noted = spawn_blocking(move || {
        let (_, config) = noting.reconfigurer.in_force();
        let subject = subject(&config).map_err(|error| error.to_string())?;
        let noted = noting.commissioned.note(procedure, result, subject);
        noted.map_err(|error| {
            format!(
                "can't be kept in {}: {error}",
                config.state.directory.display()
            )
        })
    })
    .await;
    match noted {
        Ok(Ok(())) => Answer::done(),
        Ok(Err(error)) => Answer::failure(error),
        Err(error) => Answer::failure(error),
    }
}

/// Whether a request to arm is obeyed, by a tick; `None` while it is open.
pub(super) fn arm_outcome(asked_ns: u64, tick_start_ns: u64, mode: Mode) -> Option<bool> {
    // A tick that began before the request may not have seen it.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving | Mode::Jogging => Some(true),
        Mode::Arming => None,
        // The attempt has ended, even if no poll saw it in progress.
        _ => Some(false),
    }
}

/// Why a pilot that is not ready can't be armed: the reason of now, and not the one for which
/// the last drive ended.
pub(super) fn not_ready(snapshot: &Snapshot) -> String {
    let now = snapshot.output().and_then(|output| output.preflight);
    cannot_arm(snapshot, now.or(snapshot.reason()))
}

/// Why the car can't be armed, and what to do, in the words of `singletrack status`.
pub(super) fn cannot_arm(snapshot: &Snapshot, reason: Option<Reason>) -> String {
    let mode = snapshot.mode();
    match reason {
        Some(reason) => {
            let why = Why::explain(reason.name(), &snapshot.status());
            format!("can't arm: mode {mode}: {why}")
        }
        None if matches!(mode, Mode::Driving | Mode::Slowing | Mode::Jogging) => {
            format!("can't arm: the car is driven already (mode {mode}); first end that drive")
        }
        None => format!("can't arm: mode {mode}"),
    }
}

/// To a watcher that is too slow.
const fn behind(missed: u64) -> Reply {
    Reply::Missed {
        missed,
        version: SOCKET_VERSION,
    }
}

async fn watch(write: &mut WriteHalf, daemon: &DaemonHandle, topics: &[Topic]) -> io::Result<()> {
    let mut entries = daemon.status.watchers.subscribe();
    send(write, &Answer::done()).await?;
    loop {
        match entries.recv().await {
            Ok((topic, line)) => {
                if topics.is_empty() || topics.contains(&topic) {
                    write.write_all(line.as_bytes()).await?;
                    write.write_all(b"\n").await?;
                }
            }
            Err(RecvError::Lagged(missed)) => {
                send(write, &behind(missed)).await?;
            }
            Err(RecvError::Closed) => return Ok(()),
        }
    }
}

/// Sends messages as ROS 2 encodes them: for each a line with its length, then its bytes.
async fn messages(
    write: &mut WriteHalf,
    daemon: &DaemonHandle,
    channels: &[Channel],
) -> io::Result<()> {
    let feed = &daemon.status.messages;
    let mut frames = feed.subscribe();
    let begun = Answer {
        clocks: Some(Clocks {
            monotonic_ns: feed.clocks.monotonic_ns,
            wall_ns: feed.clocks.wall_ns,
        }),
        ..Answer::done()
    };
    send(write, &begun).await?;
    let mut bytes = Vec::new();
    loop {
        match frames.recv().await {
            Ok(frames) => {
                bytes.clear();
                frames.choose(channels, &mut bytes);
                write.write_all(&bytes).await?;
            }
            Err(RecvError::Lagged(missed)) => {
                send(write, &behind(missed)).await?;
            }
            Err(RecvError::Closed) => return Ok(()),
        }
    }
}

/// Sends the state of every tick. A reader that is slow loses the oldest ones.
async fn watch_state(write: &mut WriteHalf, daemon: &DaemonHandle) -> io::Result<()> {
    limit_send_buffer(write, STATE_BUFFER)?;
    let mut states = daemon.status.states.subscribe();
    send(write, &Answer::done()).await?;
    loop {
        match states.recv().await {
            Ok(line) => write.write_all(line.as_bytes()).await?,
            Err(RecvError::Lagged(missed)) => {
                send(write, &behind(missed)).await?;
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
        let outcome = |start_ns, mode| arm_outcome(100, start_ns, mode);
        assert_eq!(outcome(100, Mode::Ready), None);
        assert_eq!(outcome(101, Mode::Arming), None);
        assert_eq!(outcome(101, Mode::Driving), Some(true));
        for mode in [Mode::Ready, Mode::Idle, Mode::Disconnected] {
            assert_eq!(outcome(101, mode), Some(false));
        }
    }
}
