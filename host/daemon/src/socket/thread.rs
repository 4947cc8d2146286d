//! The thread of the control socket: accepts clients and serves them.

use std::{
    io,
    sync::Arc,
    thread::{self, JoinHandle},
    time::Duration,
};

use tokio::{
    net::UnixListener,
    runtime,
    sync::{Notify, Semaphore},
};

use super::{
    bind::BoundSocket,
    serve::{CLIENTS, refuse, serve},
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
                let BoundSocket { listener, file } = socket;
                runtime.block_on(async {
                    match UnixListener::from_std(listener) {
                        Ok(listener) => {
                            tokio::spawn(accept(listener, daemon));
                            stopped.notified().await;
                        }
                        Err(error) => tracing::error!(%error, "can't serve the control socket"),
                    }
                });
                // Clients are disconnected before the file is removed.
                runtime.shutdown_background();
                drop(file);
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

async fn accept(listener: UnixListener, daemon: DaemonHandle) {
    let slots = Arc::new(Semaphore::new(CLIENTS));
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let daemon = daemon.clone();
                let slot = Arc::clone(&slots).try_acquire_owned();
                tokio::spawn(async move {
                    let result = match slot {
                        Ok(_slot) => serve(stream, &daemon).await,
                        Err(_) => refuse(stream, &daemon).await,
                    };
                    // A client may disconnect at any time.
                    if let Err(error) = result {
                        tracing::debug!(%error, "control client disconnected");
                    }
                });
            }
            Err(error) => {
                // Too many open files, for instance: others may be closed soon.
                tracing::warn!(%error, "control client not accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}
