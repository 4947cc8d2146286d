//! The thread of the control socket: accepts clients, reads their lines and answers them.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use singletrack_api::access::{Place, WaitingRoom};
use singletrack_api::{Answer, Clocks, Code, Reply, SOCKET_VERSION};
use singletrack_record::{Channel, Topic};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader},
    net::{TcpListener, UnixListener},
    runtime,
    sync::{
        Notify, Semaphore,
        broadcast::{self, error::RecvError},
    },
    task::{JoinSet, yield_now},
    time::timeout,
};

use super::{
    answers::{
        clocks, commissioned, configuration, end, no_command, reload, set_reference, status, tune,
    },
    arm::{arm, drive_begun},
    attend::{Client, hold, hung_up, jog},
    bind::{BoundSocket, Gate},
    command::{Attendance, Command},
    setpoint::SetpointStream,
    stream::{Connection, ReadHalf, WriteHalf, limit_send_buffer},
    stream::{LONGEST_LINE, refuse_long_line, send},
};
use crate::{
    clock::monotonic_ns,
    handle::DaemonHandle,
    shared_status::WATCHERS,
    threads::{NamedThread, message},
};

/// The largest number of clients at a time.
const CLIENTS: usize = 32;

/// The largest number of clients beyond [`CLIENTS`] whose first line is waited for.
const WAITING: usize = 64;

/// The longest wait for it.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// Bytes of the kernel's buffer of a reader of states; the kernel doubles it. It holds some six lines,
/// which a reader that is slow gets before it learns how many it has missed.
const STATE_BUFFER: usize = 4_096;

/// Serves a client beyond [`CLIENTS`]: only what ends a drive is obeyed.
async fn refuse(connection: Connection, daemon: &DaemonHandle, mut place: Place) -> io::Result<()> {
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

/// The server's thread.
#[derive(Debug)]
pub(crate) struct SocketThread {
    stop: Arc<Notify>,
    pub(crate) thread: NamedThread<()>,
}

impl SocketThread {
    pub(crate) fn start(socket: BoundSocket, daemon: DaemonHandle) -> Result<Self, String> {
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(|error| format!("can't start the socket thread: {error}"))?;
        let thread = NamedThread::spawn("socket", move || {
            let port = socket.port;
            let port = port.map(|port| ((port.listener, port.gate), port.file));
            let (port, token_file) = port.unzip();
            runtime.block_on(async {
                match listen(socket.listener, port, daemon) {
                    Ok(accepting) => until_one_ends(accepting, stopped.notified()).await,
                    Err(error) => tracing::error!(%error, "can't serve the control socket"),
                }
            });
            // Clients are disconnected before the files are removed.
            runtime.shutdown_background();
            drop((socket.file, token_file));
        })?;
        Ok(Self { stop, thread })
    }

    /// Asks the thread to end.
    pub(crate) fn end(self) -> NamedThread<()> {
        self.stop.notify_one();
        self.thread
    }
}

/// Waits for the stop, or for the end of a task that accepts clients: none ends but by a panic, and
/// without it no stop would get in. The thread ends then, and with it the daemon.
async fn until_one_ends(mut accepting: JoinSet<()>, stopped: impl Future<Output = ()>) {
    tokio::select! {
        () = stopped => {}
        ended = accepting.join_next() => match ended {
            Some(Err(error)) if error.is_panic() => {
                let panic = error.into_panic();
                tracing::error!("the task that accepts clients has panicked: {}", message(&*panic));
            }
            _ => tracing::error!("the task that accepts clients has ended"),
        },
    }
}

/// Accepts clients from now on, in the tasks that it returns. Those of the port and of the socket share
/// the places.
fn listen(
    listener: std::os::unix::net::UnixListener,
    port: Option<(std::net::TcpListener, Arc<Gate>)>,
    daemon: DaemonHandle,
) -> io::Result<JoinSet<()>> {
    let mut accepting = JoinSet::new();
    let listener = UnixListener::from_std(listener)?;
    let places = Arc::new(Places {
        clients: Arc::new(Semaphore::new(CLIENTS)),
        waiting: WaitingRoom::new(WAITING),
    });
    if let Some((listener, gate)) = port {
        let listener = Listener::Tcp(TcpListener::from_std(listener)?, gate);
        accepting.spawn(accept(listener, daemon.clone(), Arc::clone(&places)));
    }
    accepting.spawn(accept(Listener::Unix(listener), daemon, places));
    Ok(accepting)
}

/// The places for clients, and for those beyond.
#[derive(Debug)]
struct Places {
    clients: Arc<Semaphore>,
    waiting: WaitingRoom,
}

/// Where clients come from.
enum Listener {
    Unix(UnixListener),
    /// Only those come in whom the gate lets through.
    Tcp(TcpListener, Arc<Gate>),
}

async fn accept(listener: Listener, daemon: DaemonHandle, places: Arc<Places>) {
    loop {
        let accepted = match &listener {
            Listener::Unix(listener) => {
                listener.accept().await.map(|(unix, _)| (unix.into(), None))
            }
            Listener::Tcp(listener, gate) => listener.accept().await.map(|(tcp, peer)| {
                // An answer is one small write, which must not wait for the next one.
                let _ = tcp.set_nodelay(true);
                (tcp.into(), Some((Arc::clone(gate), peer)))
            }),
        };
        match accepted {
            Ok((connection, gate)) => {
                let (daemon, places) = (daemon.clone(), Arc::clone(&places));
                tokio::spawn(async move {
                    // A client may disconnect at any time.
                    if let Err(error) = admit(connection, gate, &daemon, &places).await {
                        tracing::debug!(%error, "control client disconnected");
                    }
                });
                // Connections that lose their place are closed before there are more.
                yield_now().await;
            }
            Err(error) => {
                // Too many open files, for instance: others may be closed soon.
                tracing::warn!(%error, "control client not accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// Serves a client if the gate lets it through, and if there is a place.
async fn admit(
    mut connection: Connection,
    gate: Option<(Arc<Gate>, SocketAddr)>,
    daemon: &DaemonHandle,
    places: &Places,
) -> io::Result<()> {
    if let Some((gate, peer)) = gate
        && !gate.passes(&mut connection, peer).await?
    {
        return Ok(());
    }
    match Arc::clone(&places.clients).try_acquire_owned() {
        Ok(_place) => serve(connection, daemon).await,
        Err(_) => refuse(connection, daemon, places.waiting.enter()).await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_a_task_that_accepts_ends_the_thread_and_a_stop_does() {
        let runtime = runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let mut accepting = JoinSet::new();
            accepting.spawn(std::future::pending());
            accepting.spawn(async { panic!("planted") });
            until_one_ends(accepting, std::future::pending()).await;
            let mut accepting = JoinSet::new();
            accepting.spawn(std::future::pending());
            until_one_ends(accepting, async {}).await;
        });
    }
}
