//! The thread of the control socket: accepts clients and serves them.

use std::{io, sync::Arc, time::Duration};

use singletrack_api::access::WaitingRoom;
use tokio::{
    net::{TcpListener, UnixListener},
    runtime,
    sync::{Notify, Semaphore},
    task::{JoinSet, yield_now},
};

use super::{
    bind::BoundSocket,
    serve::{CLIENTS, WAITING, refuse, serve},
    stream::Connection,
    tcp::{BoundPort, Gate},
};
use crate::{
    handle::DaemonHandle,
    threads::{NamedThread, NotStarted, message},
};

/// The server's thread.
#[derive(Debug)]
pub(crate) struct SocketThread {
    stop: Arc<Notify>,
    pub(crate) thread: NamedThread<()>,
}

impl SocketThread {
    pub(crate) fn start(socket: BoundSocket, daemon: DaemonHandle) -> Result<Self, NotStarted> {
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(|source| NotStarted {
                name: "socket",
                source,
            })?;
        let thread = NamedThread::spawn("socket", move || {
            let BoundSocket {
                listener,
                file,
                port,
            } = socket;
            let (port, token_file) = port
                .map(
                    |BoundPort {
                         listener,
                         gate,
                         file,
                     }| ((listener, gate), file),
                )
                .unzip();
            runtime.block_on(async {
                match listen(listener, port, daemon) {
                    Ok(accepting) => until_one_ends(accepting, stopped.notified()).await,
                    Err(error) => tracing::error!(%error, "can't serve the control socket"),
                }
            });
            // Clients are disconnected before the files are removed.
            runtime.shutdown_background();
            drop((file, token_file));
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

/// Accepts clients from now on, in the tasks that it returns. Those of the port and of the socket share the places.
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
        let listener = TcpListener::from_std(listener)?;
        accepting.spawn(accept_tcp(
            listener,
            gate,
            daemon.clone(),
            Arc::clone(&places),
        ));
    }
    accepting.spawn(accept(listener, daemon, places));
    Ok(accepting)
}

/// The places for clients, and for those beyond.
#[derive(Debug)]
struct Places {
    clients: Arc<Semaphore>,
    waiting: WaitingRoom,
}

async fn accept(listener: UnixListener, daemon: DaemonHandle, places: Arc<Places>) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let (daemon, places) = (daemon.clone(), Arc::clone(&places));
                tokio::spawn(async move {
                    disconnected(admit(stream.into(), &daemon, &places).await);
                });
                // Connections that lose their place are closed before there are more.
                yield_now().await;
            }
            Err(error) => not_accepted(&error).await,
        }
    }
}

async fn accept_tcp(
    listener: TcpListener,
    gate: Arc<Gate>,
    daemon: DaemonHandle,
    places: Arc<Places>,
) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                let gate = Arc::clone(&gate);
                let (daemon, places) = (daemon.clone(), Arc::clone(&places));
                tokio::spawn(async move {
                    disconnected(match gate.pass(stream, peer).await {
                        Ok(Some(connection)) => admit(connection, &daemon, &places).await,
                        Ok(None) => Ok(()),
                        Err(error) => Err(error),
                    });
                });
                yield_now().await;
            }
            Err(error) => not_accepted(&error).await,
        }
    }
}

/// Serves a client if there is a place.
async fn admit(connection: Connection, daemon: &DaemonHandle, places: &Places) -> io::Result<()> {
    match Arc::clone(&places.clients).try_acquire_owned() {
        Ok(_place) => serve(connection, daemon).await,
        Err(_) => refuse(connection, daemon, places.waiting.enter()).await,
    }
}

/// A client may disconnect at any time.
fn disconnected(result: io::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "control client disconnected");
    }
}

/// Too many open files, for instance: others may be closed soon.
async fn not_accepted(error: &io::Error) {
    tracing::warn!(%error, "control client not accepted");
    tokio::time::sleep(Duration::from_millis(100)).await;
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
