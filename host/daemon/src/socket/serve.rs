//! Serves one client: reads its lines and answers them.

use std::{io, time::Duration};

use singletrack_api::access::Place;
use singletrack_api::{Answer, Clocks, Code, Reply, SOCKET_VERSION};
use singletrack_record::{Channel, Topic};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    sync::broadcast::{self, error::RecvError},
    task::yield_now,
    time::timeout,
};

use super::{
    answers::{
        clocks, commissioned, configuration, end, no_command, reload, set_reference, status, tune,
    },
    arm::{arm, drive_begun},
    attend::{Client, hold, hung_up, jog},
    command::{Attendance, Command},
    setpoint::SetpointStream,
    stream::{Connection, ReadHalf, WriteHalf, limit_send_buffer},
    stream::{LONGEST_LINE, send, skip_line},
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
        (Some(Ok(Ok(_))), Ok(Command::End(request))) => end(request, daemon),
        _ => Answer::failure(
            Code::Busy,
            format!("{CLIENTS} clients are connected; close one"),
        ),
    };
    send(&mut write, &answer).await
}

pub(super) async fn serve(connection: Connection, daemon: &DaemonHandle) -> io::Result<()> {
    let mut client = Client {
        read: connection.read,
        write: connection.write,
        daemon,
        setpoints: SetpointStream::default(),
    };
    let mut line = Vec::new();
    loop {
        line.clear();
        // One line, and then a line of each other client: none that sends without a pause delays the
        // stop of another one by more.
        yield_now().await;
        let count = (&mut client.read)
            .take(LONGEST_LINE)
            .read_until(b'\n', &mut line)
            .await?;
        if count == 0 {
            return Ok(());
        }
        if !line.ends_with(b"\n") && count as u64 == LONGEST_LINE {
            // The rest is read first: a client that is still writing would not read the
            // answer.
            skip_line(&mut client.read).await?;
            let answer = Answer::failure(
                Code::Invalid,
                format!("a line is at most {LONGEST_LINE} bytes long"),
            );
            send(&mut client.write, &answer).await?;
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
            send(&mut client.write, &Answer::failure(Code::Busy, error)).await?;
            continue;
        }
        match command {
            Ok(Command::Watch { topics }) => {
                return until_gone(&mut client.read, watch(&mut client.write, daemon, &topics))
                    .await;
            }
            Ok(Command::Messages { channels }) => {
                return until_gone(
                    &mut client.read,
                    messages(&mut client.write, daemon, &channels),
                )
                .await;
            }
            Ok(Command::WatchState) => {
                return until_gone(&mut client.read, watch_state(&mut client.write, daemon)).await;
            }
            Ok(Command::Arm(request)) if request.attendance == Attendance::Hold => {
                if !hold(&mut client, request).await? {
                    return Ok(());
                }
            }
            Ok(Command::ArmJog) => {
                if !jog(&mut client).await? {
                    return Ok(());
                }
            }
            Ok(Command::Jog(_)) => {
                let error = "jog gives pulses on a connection that jogs: arm first with \
                             {\"command\":\"arm\",\"attendance\":\"hold\",\"jog\":true}";
                send(&mut client.write, &Answer::failure(Code::NoDrive, error)).await?;
            }
            Ok(Command::Reload) => {
                send(&mut client.write, &reload(daemon).await).await?;
            }
            Ok(Command::Arm(request)) => {
                // A client that has given up must not be obeyed later.
                let armed = tokio::select! {
                    armed = arm(daemon, request) => armed,
                    () = hung_up(&mut client.read) => return Ok(()),
                };
                let answer = armed.map_or_else(Answer::refusal, |()| drive_begun(daemon));
                send(&mut client.write, &answer).await?;
            }
            Ok(Command::Hold) => {
                let error = "hold renews a drive that this connection armed with the attendance \
                             \"hold\"; there is none";
                send(&mut client.write, &Answer::failure(Code::NoDrive, error)).await?;
            }
            Ok(Command::Status) => send(&mut client.write, &status(daemon)).await?,
            Ok(Command::End(request)) => send(&mut client.write, &end(request, daemon)).await?,
            Ok(Command::Clock) => send(&mut client.write, &clocks()).await?,
            Ok(Command::Configuration) => send(&mut client.write, &configuration(daemon)).await?,
            Ok(Command::SetReference(reference)) => {
                send(&mut client.write, &set_reference(reference, daemon).await).await?;
            }
            Ok(Command::Tune(tuning)) => {
                send(&mut client.write, &tune(tuning, daemon).await).await?;
            }
            Ok(Command::Commissioned {
                procedure,
                result,
                uncalibrated,
            }) => {
                let answer = commissioned(procedure, result, uncalibrated, daemon).await;
                send(&mut client.write, &answer).await?;
            }
            Ok(Command::Setpoint(setpoint)) => {
                if let Some(answer) = client.setpoints.pass(daemon, &setpoint) {
                    send(&mut client.write, &answer).await?;
                }
            }
            Err(error) => send(&mut client.write, &no_command(daemon, &error)).await?,
        }
    }
}

/// Serves a watcher, who sends no more lines. Reading detects that it has disconnected, also while
/// there is nothing to send.
async fn until_gone(
    read: &mut BufReader<ReadHalf>,
    watching: impl Future<Output = io::Result<()>>,
) -> io::Result<()> {
    let mut rest = [0];
    tokio::select! {
        result = watching => result,
        closed = read.read(&mut rest) => closed.map(drop),
    }
}

/// Sends what `encode` makes of everything that comes. A watcher that is too slow loses the oldest.
async fn relay<T: Clone>(
    write: &mut WriteHalf,
    mut feed: broadcast::Receiver<T>,
    encode: impl Fn(T, &mut Vec<u8>),
) -> io::Result<()> {
    let mut bytes = Vec::new();
    loop {
        match feed.recv().await {
            Ok(item) => {
                bytes.clear();
                encode(item, &mut bytes);
                write.write_all(&bytes).await?;
            }
            Err(RecvError::Lagged(missed)) => {
                let version = SOCKET_VERSION;
                send(write, &Reply::Missed { missed, version }).await?;
            }
            Err(RecvError::Closed) => return Ok(()),
        }
    }
}

async fn watch(write: &mut WriteHalf, daemon: &DaemonHandle, topics: &[Topic]) -> io::Result<()> {
    let entries = daemon.status.watchers.subscribe();
    send(write, &Answer::done()).await?;
    relay(write, entries, |(topic, line), bytes| {
        if topics.is_empty() || topics.contains(&topic) {
            bytes.extend_from_slice(line.as_bytes());
            bytes.push(b'\n');
        }
    })
    .await
}

/// Sends messages as ROS 2 encodes them: for each a line with its length, then its bytes.
async fn messages(
    write: &mut WriteHalf,
    daemon: &DaemonHandle,
    channels: &[Channel],
) -> io::Result<()> {
    let feed = &daemon.status.messages;
    let frames = feed.subscribe();
    let begun = Answer {
        clocks: Some(Clocks {
            monotonic_ns: feed.clocks.monotonic_ns,
            wall_ns: feed.clocks.wall_ns,
        }),
        ..Answer::done()
    };
    send(write, &begun).await?;
    relay(write, frames, |frames, bytes| {
        frames.choose(channels, bytes);
    })
    .await
}

/// Sends the state of every tick. A reader that is slow loses the oldest ones.
async fn watch_state(write: &mut WriteHalf, daemon: &DaemonHandle) -> io::Result<()> {
    limit_send_buffer(write, STATE_BUFFER)?;
    let states = daemon.status.states.subscribe();
    send(write, &Answer::done()).await?;
    relay(write, states, |line, bytes| {
        bytes.extend_from_slice(line.as_bytes());
    })
    .await
}
