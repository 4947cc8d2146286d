//! Serves one client: reads its lines and answers them.

use std::{io, time::Duration};

use singletrack_access::Place;
use singletrack_api::{Answer, Clocks, Reply, SOCKET_VERSION};
use singletrack_record::{Channel, Topic};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt},
    sync::broadcast::error::RecvError,
    task::yield_now,
    time::timeout,
};

use super::{
    answers::{answer, clocks, commissioned, configuration, no_command, reload, set_reference},
    arm::arm,
    attend::{hold, hung_up, jog},
    command::{Attendance, Command, SimpleRequest},
    lines::{LONGEST_LINE, send, skip_line},
    setpoint::SetpointStream,
    stream::{Connection, WriteHalf, limit_send_buffer},
    tune::tune,
};
use crate::{clock::monotonic_ns, handle::DaemonHandle, shared_status::WATCHERS};

/// The largest number of clients at a time.
pub(super) const CLIENTS: usize = 32;

/// The largest number of clients beyond [`CLIENTS`] whose first line is waited for.
pub(super) const WAITING: usize = 64;

/// The longest wait for it.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// Bytes of the kernel's buffer of a reader of states; the kernel doubles it. It holds some six lines,
/// which a reader that is slow gets before it learns how many it has missed.
const STATE_BUFFER: usize = 4_096;

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
