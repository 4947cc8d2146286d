//! The thread of the control socket: accepts clients and serves them.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

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
    tcp::Gate,
};
use crate::{
    handle::DaemonHandle,
    threads::{NamedThread, message},
};

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
