//! The control socket: one JSON object a line, each way. Version 1.
//!
//! | to the daemon | from the daemon |
//! |---|---|
//! | `{"version":1,"command":"status"}` | `{"version":1,"ok":true,"status":{...}}` |
//! | `{"version":1,"command":"arm"}` | once it drives, or what is in the way |
//! | `{"version":1,"command":"disarm"}` | at once; the car slows down and stops |
//! | `{"version":1,"command":"stop"}` | at once; neutral until the board is reset |
//! | `{"version":1,"command":"set-reference","reference":{"kind":"circle",...}}` | once it is in force, as `{"version":1,"ok":true,"configuration":2}`, or why it is not |
//! | `{"version":1,"command":"setpoint","velocity_m_s":[0.4,0.0]}` | nothing, unless something is wrong with it |
//! | `{"version":1,"command":"watch","topics":["tick"]}` | `{"version":1,"ok":true}`, then every entry of the record as it is made, with a `topic` |
//!
//! What fails is answered with `{"version":1,"ok":false,"error":"..."}`. A
//! watcher that is too slow gets `{"version":1,"missed":N}`. Within version 1,
//! commands and keys are added and never changed or taken away.
//!
//! **References.** `reference` has the keys of `[reference]` in the
//! configuration; `file` is an absolute path that the daemon may read. It is
//! refused while the car drives, and lasts until the configuration is read anew.
//!
//! **Set-points** are obeyed while `reference.kind` is `"external"`, many a
//! second on one connection. A set-point says how fast P should move, in m/s in
//! the frame of the cameras, and may say where it should be, in m:
//! `"position_m":[0.5,0.0]`. With `"time_ns"`, when it was decided on
//! `CLOCK_MONOTONIC`, it ages from then on and not from when it was read: one
//! that was under way for long is as good as none. Only the newest counts; when
//! none younger than `reference.setpoint_timeout_ms` is left, the car stops.
//! Whoever sends wrong ones and never reads the answers is in the end not read
//! any more.

mod bind;
mod command;
mod serve;

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

use crate::daemon::View;

pub(crate) use bind::BoundSocket;
pub use bind::SocketError;
pub use command::{Command, Question};

/// The version of the protocol. Exact match.
pub const SOCKET_VERSION: u32 = 1;

/// The most clients at a time.
const CLIENTS: usize = 32;

/// The server's thread.
#[derive(Debug)]
pub(crate) struct SocketThread {
    stop: Arc<Notify>,
    thread: JoinHandle<()>,
}

impl SocketThread {
    pub(crate) fn start(socket: BoundSocket, view: View) -> io::Result<Self> {
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
                            tokio::spawn(accept(listener, view));
                            stopped.notified().await;
                        }
                        Err(error) => tracing::error!(%error, "no control socket"),
                    }
                });
                // The clients go before the file does.
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

async fn accept(listener: UnixListener, view: View) {
    let places = Arc::new(Semaphore::new(CLIENTS));
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let view = view.clone();
                let place = Arc::clone(&places).try_acquire_owned();
                tokio::spawn(async move {
                    let result = match place {
                        Ok(_place) => serve::serve(stream, &view).await,
                        Err(_) => serve::refuse(stream, &view).await,
                    };
                    // A client may go as it likes.
                    if let Err(error) = result {
                        tracing::debug!(%error, "control client gone");
                    }
                });
            }
            Err(error) => {
                // Such as too many open files: others may close theirs.
                tracing::warn!(%error, "control client not accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}
