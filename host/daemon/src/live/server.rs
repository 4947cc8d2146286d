//! The thread and the WebSocket server of the live view.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServer,
    WebSocketServerHandle,
};
use singletrack_core::config::LiveSection;
use singletrack_record::{Channel, ClockMapping, Encoder, FeedInput, FeedOutput, feed};
use tokio::{
    net::TcpListener,
    runtime::{self, Runtime},
};

use super::{
    relay::{Inner, relay},
    status::{LiveError, LiveView},
};

/// Entries that may wait to be encoded: most of a second.
const CAPACITY: usize = 256;

/// Messages that may wait for a viewer beyond the kernel's queue: older ones are out of
/// date.
const BACKLOG: usize = 400;

/// Interval at which the thread polls its ring.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// The longest wait for viewers when the server closes.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(50);

/// The server's thread.
#[derive(Debug)]
pub(crate) struct LiveThread {
    pub(crate) view: LiveView,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl LiveThread {
    /// Starts to listen. Returns the ring for the entries to publish. `start` is the
    /// clock mapping of the record, so that times agree.
    pub(crate) fn start(
        section: LiveSection,
        start: ClockMapping,
    ) -> Result<(Self, FeedInput), LiveError> {
        let failed = |error: io::Error| LiveError::Server(error.to_string());
        let address = SocketAddr::new(section.address, section.port);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(failed)?;
        let (input, output) = feed(CAPACITY);
        let stop = Arc::new(AtomicBool::new(false));
        let viewers = Arc::new(AtomicU64::new(0));
        let (port_in, port_out) = mpsc::sync_channel(1);
        let thread = thread::Builder::new()
            .name("live".to_owned())
            .spawn({
                let (stop, viewers) = (Arc::clone(&stop), Arc::clone(&viewers));
                move || {
                    let server = match Server::start(&runtime, address) {
                        Ok(server) => server,
                        Err(error) => {
                            // `start` waits for it.
                            let _ = port_in.send(Err(error));
                            return;
                        }
                    };
                    let _ = port_in.send(Ok(server.port));
                    server.run(&runtime, Encoder::new(start), output, &viewers, &stop);
                }
            })
            .map_err(failed)?;
        let port = port_out
            .recv()
            .map_err(|_| LiveError::Server("its thread has ended".to_owned()))??;
        let address = SocketAddr::new(section.address, port);
        if !section.address.is_loopback() {
            tracing::warn!(%address, "the live view listens beyond loopback and has no authentication");
        }
        tracing::info!(%address, "live view started");
        let view = LiveView { address, viewers };
        let thread = Some(thread);
        Ok((Self { view, stop, thread }, input))
    }
}

impl Drop for LiveThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the live view's thread has panicked");
        }
    }
}

struct Server {
    /// The channels and the server hold it weakly.
    context: Arc<Context>,
    /// Indexed by [`Channel::index`].
    channels: Vec<Arc<RawChannel>>,
    handle: WebSocketServerHandle,
    /// The relay's end of the server, and the port that the relay listens on.
    inner: Inner,
    port: u16,
}

impl Server {
    fn start(runtime: &Runtime, address: SocketAddr) -> Result<Self, LiveError> {
        let failed = |error: FoxgloveError| LiveError::Server(error.to_string());
        let listen = |source| LiveError::Listen { address, source };
        let listener = runtime
            .block_on(TcpListener::bind(address))
            .map_err(listen)?;
        let port = listener.local_addr().map_err(listen)?.port();
        let context = Context::new();
        let channels = Channel::all()
            .map(|channel| {
                let schema = Schema::new(
                    channel.schema_name(),
                    Channel::SCHEMA_ENCODING,
                    channel.schema_text().into_bytes(),
                );
                ChannelBuilder::new(channel.topic())
                    .message_encoding(Channel::MESSAGE_ENCODING)
                    .schema(schema)
                    .context(&context)
                    .build_raw()
            })
            .collect::<Result<_, _>>()
            .map_err(failed)?;
        let handle = runtime.block_on(listen_inside(&context)).map_err(failed)?;
        let inner = Inner::default();
        inner.listens(handle.port());
        runtime.spawn(relay(listener, inner.clone()));
        Ok(Self {
            context,
            channels,
            handle,
            inner,
            port,
        })
    }

    /// Publishes entries until `stop` is set.
    fn run(
        self,
        runtime: &Runtime,
        mut encoder: Encoder,
        mut entries: FeedOutput,
        viewers: &AtomicU64,
        stop: &AtomicBool,
    ) {
        let Self {
            context,
            channels,
            mut handle,
            inner,
            ..
        } = self;
        runtime.block_on(async {
            while !stop.load(Ordering::Acquire) {
                if inner.take_ended() {
                    match listen_inside(&context).await {
                        Ok(new) => {
                            inner.listens(new.port());
                            // Its viewers connect again.
                            drop(core::mem::replace(&mut handle, new).stop());
                        }
                        Err(error) => tracing::warn!(%error, "the live view does not listen"),
                    }
                }
                let count = handle.client_count();
                viewers.store(count as u64, Ordering::Relaxed);
                while let Some(entry) = entries.pop() {
                    // Also without viewers: diagnostics are encoded on changes only.
                    let Ok(publications) = encoder.encode(&entry) else {
                        continue;
                    };
                    for publication in publications.filter(|_| count > 0) {
                        if let Some(channel) = channels.get(publication.channel.index()) {
                            channel.log_with_meta(
                                publication.bytes,
                                PartialMetadata {
                                    log_time: Some(publication.log_time_ns),
                                },
                            );
                        }
                    }
                }
                tokio::time::sleep(POLL_INTERVAL).await;
            }
            // A viewer that does not close its connection is not waited for.
            let _ = tokio::time::timeout(CLOSE_TIMEOUT, handle.stop().wait()).await;
        });
    }
}

/// Starts a WebSocket server on loopback, for the relay.
async fn listen_inside(context: &Arc<Context>) -> Result<WebSocketServerHandle, FoxgloveError> {
    WebSocketServer::new()
        .name(concat!("singletrackd ", env!("CARGO_PKG_VERSION")))
        .context(context)
        // Viewers can only subscribe.
        .capabilities([])
        .message_backlog_size(BACKLOG)
        .bind(Ipv4Addr::LOCALHOST.to_string(), 0)
        .start()
        .await
}
