//! The thread of the control socket: accepts clients and serves them.

use std::{
    io,
    sync::Arc,
    thread::{self, JoinHandle},
    time::Duration,
};

use singletrack_access::WaitingRoom;
use tokio::{
    net::{TcpListener, UnixListener},
    runtime,
    sync::{Notify, Semaphore},
    task::yield_now,
};

use super::{
    bind::BoundSocket,
    serve::{CLIENTS, WAITING, refuse, serve},
    stream::Connection,
    tcp::{BoundPort, Gate},
};
use crate::handle::DaemonHandle;

/// The server's thread.
#[derive(Debug)]
pub(crate) struct SocketThread {
    stop: Arc<Notify>,
    thread: JoinHandle<()>,
}

impl SocketThread {
    pub(crate) fn start(socket: BoundSocket, daemon: DaemonHandle) -> io::Result<Self> {
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()?;
        let thread = thread::Builder::new()
            .name("socket".to_owned())
            .spawn(move || {
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
                        Ok(()) => stopped.notified().await,
                        Err(error) => tracing::error!(%error, "can't serve the control socket"),
                    }
                });
                // Clients are disconnected before the files are removed.
                runtime.shutdown_background();
                drop((file, token_file));
            })?;
        Ok(Self { stop, thread })
    }

    pub(crate) fn stop(self) {
        self.stop.notify_one();
        if self.thread.join().is_err() {
            tracing::error!("the control socket's thread has panicked");
        }
    }
}

/// Accepts clients from now on. Those of the port and of the socket share the places.
fn listen(
    listener: std::os::unix::net::UnixListener,
    port: Option<(std::net::TcpListener, Arc<Gate>)>,
    daemon: DaemonHandle,
) -> io::Result<()> {
    let listener = UnixListener::from_std(listener)?;
    let places = Arc::new(Places {
        clients: Arc::new(Semaphore::new(CLIENTS)),
        waiting: WaitingRoom::new(WAITING),
    });
    if let Some((listener, gate)) = port {
        let listener = TcpListener::from_std(listener)?;
        tokio::spawn(accept_tcp(
            listener,
            gate,
            daemon.clone(),
            Arc::clone(&places),
        ));
    }
    tokio::spawn(accept(listener, daemon, places));
    Ok(())
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
