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
    stream::{LONGEST_LINE, refuse_long_line, send},
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
            refuse_long_line(&mut client.read, &mut client.write).await?;
            continue;
        }
        let command = Command::parse(&line, monotonic_ns());
        let watches = matches!(
            command,
            Ok(Command::Watch { .. } | Command::Messages { .. } | Command::WatchState)
        );
        let place = watches.then(|| daemon.status.watch_places.try_acquire());
        let Client { read, write, .. } = &mut client;
        let answer = match command {
            Ok(_) if matches!(place, Some(Err(_))) => {
                let error = format!("{WATCHERS} clients watch; close one: the others may command");
                Answer::failure(Code::Busy, error)
            }
            Ok(Command::Watch { topics }) => {
                return until_gone(read, watch(write, daemon, &topics)).await;
            }
            Ok(Command::Messages { channels }) => {
                return until_gone(read, messages(write, daemon, &channels)).await;
            }
            Ok(Command::WatchState) => {
                return until_gone(read, watch_state(write, daemon)).await;
            }
            Ok(Command::Arm(request)) if request.attendance == Attendance::Hold => {
                match hold(&mut client, request).await? {
                    true => continue,
                    false => return Ok(()),
                }
            }
            Ok(Command::ArmJog) => match jog(&mut client).await? {
                true => continue,
                false => return Ok(()),
            },
            Ok(Command::Jog(_)) => Answer::failure(
                Code::NoDrive,
                "jog gives pulses on a connection that jogs: arm first with \
                 {\"command\":\"arm\",\"attendance\":\"hold\",\"jog\":true}",
            ),
            Ok(Command::Reload) => reload(daemon).await,
            Ok(Command::Arm(request)) => {
                // A client that has given up must not be obeyed later.
                let armed = tokio::select! {
                    armed = arm(daemon, request) => armed,
                    () = hung_up(read) => return Ok(()),
                };
                armed.map_or_else(Answer::refusal, |()| drive_begun(daemon))
            }
            Ok(Command::Hold) => Answer::failure(
                Code::NoDrive,
                "hold renews a drive that this connection armed with the attendance \"hold\"; \
                 there is none",
            ),
            Ok(Command::Status) => status(daemon),
            Ok(Command::End(request)) => end(request, daemon),
            Ok(Command::Clock) => clocks(),
            Ok(Command::Configuration) => configuration(daemon),
            Ok(Command::SetReference(reference)) => set_reference(reference, daemon).await,
            Ok(Command::Tune(tuning)) => tune(tuning, daemon).await,
            Ok(Command::Commissioned {
                procedure,
                result,
                uncalibrated,
            }) => commissioned(procedure, result, uncalibrated, daemon).await,
            Ok(Command::Setpoint(setpoint)) => match client.setpoints.pass(daemon, &setpoint) {
                Some(rejection) => rejection,
                None => continue,
            },
            Err(error) => no_command(daemon, &error),
        };
        send(&mut client.write, &answer).await?;
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
