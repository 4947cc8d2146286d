//! The live view: the messages of the record, as they are made, for Foxglove,
//! Lichtblick and PlotJuggler.
//!
//! The server only publishes: a client can subscribe and nothing else. Commands go through the
//! control socket. There is no authentication, nor a limit to the number of viewers: it listens on
//! loopback only. For a slow viewer a bounded number of messages waits, and then messages are
//! dropped.

use std::{
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServer,
    WebSocketServerHandle, websocket::Status,
};
use singletrack_api::{ClientError, Message, MessageStream, Received};
use singletrack_core::config::LiveSection;
use singletrack_record::{Channel, ClockMapping};
use tokio::{
    runtime::{self, Runtime},
    sync::{Notify, watch},
    time::timeout,
};

use crate::{Follower, PATIENCE, ServerThread};

/// Messages that may wait for a viewer beyond the kernel's queue: older ones are out of
/// date.
const BACKLOG: usize = 400;

/// Interval at which viewers are counted and told about the daemon.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// The longest wait for viewers when the server closes.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(50);

/// The name of the message about a lost daemon.
const LOST: &str = "daemon";

/// A live view. It ends when this value is dropped.
#[derive(Debug)]
pub struct Live {
    /// The address that it listens on, with the port in use.
    pub address: SocketAddr,
    _server: ServerThread,
    _follower: Follower,
}

/// What the threads share.
#[derive(Debug, Default)]
struct Shared {
    is_watched: AtomicBool,
    /// Why there is no daemon.
    lost: watch::Sender<Option<String>>,
}

impl Live {
    /// Starts to listen, for the daemon at `socket`, which need not run.
    ///
    /// # Errors
    ///
    /// The address can't be listened on, or a thread does not start.
    pub fn start(socket: PathBuf, section: LiveSection) -> Result<Self, String> {
        let address = SocketAddr::new(section.address, section.port);
        if !address.ip().is_loopback() {
            return Err(format!(
                "{} is not an address of loopback: the live view has no authentication; leave \
                 live.address and --address at 127.0.0.1, and forward the port with `ssh -L`",
                address.ip()
            ));
        }
        Self::listen(address, socket).map_err(|error| match error {
            FoxgloveError::Bind(error) => format!(
                "can't listen on {address} for the live view: {error}; choose another \
                 live.address or live.port, or give --port"
            ),
            error => format!("the live view does not start: {error}"),
        })
    }

    fn listen(address: SocketAddr, socket: PathBuf) -> Result<Self, FoxgloveError> {
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()?;
        let publisher = Publisher::new()?;
        // The server joins them with a colon.
        let host = match address.ip() {
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        let server = WebSocketServer::new()
            .name(concat!("singletrack ", env!("CARGO_PKG_VERSION")))
            .context(&publisher.context)
            // Viewers can only subscribe.
            .capabilities([])
            .message_backlog_size(BACKLOG)
            .bind(host, address.port());
        let handle = runtime.block_on(server.start())?;
        let address = SocketAddr::new(address.ip(), handle.port());
        let shared = Arc::new(Shared::default());
        let served = Arc::clone(&shared);
        let server = ServerThread::start("live", move |stop| {
            serve(&runtime, handle, &served, stop);
        })?;
        let follower = Follower::start(move || {
            let followed = follow(&socket, &publisher, &shared);
            followed.inspect_err(|error| drop(shared.lost.send_replace(Some(error.to_string()))))
        })?;
        Ok(Self {
            address,
            _server: server,
            _follower: follower,
        })
    }
}

/// The channels of the record.
struct Publisher {
    /// The channels and the server hold it weakly.
    context: Arc<Context>,
    channels: Vec<(Channel, Arc<RawChannel>)>,
}

impl Publisher {
    fn new() -> Result<Self, FoxgloveError> {
        let context = Context::new();
        let channels = Channel::all()
            .map(|channel| {
                let text = channel.schema_text().into_bytes();
                let schema = Schema::new(channel.schema_name(), Channel::SCHEMA_ENCODING, text);
                let raw = ChannelBuilder::new(channel.topic())
                    .message_encoding(Channel::MESSAGE_ENCODING)
                    .schema(schema)
                    .context(&context)
                    .build_raw()?;
                Ok::<_, FoxgloveError>((channel, raw))
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { context, channels })
    }

    /// Publishes a message. `log_time_ns` is that of the messages about one entry, of which its own
    /// is the first.
    fn publish(&self, message: Message<'_>, clocks: ClockMapping, log_time_ns: &mut u64) {
        let is_of = |(channel, _): &&(Channel, _)| channel.topic() == message.topic;
        // A newer daemon may have others.
        let Some((channel, raw)) = self.channels.iter().find(is_of) else {
            return;
        };
        if let Channel::Entry(topic) = channel
            && let Some(time_ns) = topic.time_ns(message.bytes)
        {
            *log_time_ns = clocks.wall_ns_at(time_ns);
        }
        let metadata = PartialMetadata {
            log_time: Some(*log_time_ns),
        };
        raw.log_with_meta(message.bytes, metadata);
    }
}

/// Passes the daemon's messages on for as long as there are viewers.
fn follow(socket: &Path, publisher: &Publisher, shared: &Shared) -> Result<(), ClientError> {
    if !shared.is_watched.load(Ordering::Relaxed) {
        return Ok(());
    }
    let mut stream = MessageStream::open(socket, &[], PATIENCE)?;
    shared.lost.send_replace(None);
    let clocks = stream.clocks;
    let clocks = ClockMapping {
        monotonic_ns: clocks.monotonic_ns,
        wall_ns: clocks.wall_ns,
    };
    let mut log_time_ns = clocks.wall_ns;
    while shared.is_watched.load(Ordering::Relaxed) {
        // What was missed is not shown.
        if let Received::Message(message) = stream.receive()? {
            publisher.publish(message, clocks, &mut log_time_ns);
        }
    }
    Ok(())
}

/// Serves viewers until `stop`.
fn serve(runtime: &Runtime, handle: WebSocketServerHandle, shared: &Shared, stop: &Notify) {
    runtime.block_on(async {
        let mut told = Told::default();
        let mut stopped = core::pin::pin!(stop.notified());
        while timeout(POLL_INTERVAL, &mut stopped).await.is_err() {
            let viewers = handle.client_count();
            shared.is_watched.store(viewers > 0, Ordering::Relaxed);
            told.tell(&handle, viewers, shared.lost.borrow().clone());
        }
        // A viewer that does not close its connection is not waited for.
        let _ = timeout(CLOSE_TIMEOUT, handle.stop().wait()).await;
    });
}

/// What the viewers know of the daemon.
#[derive(Default)]
struct Told {
    viewers: usize,
    lost: Option<String>,
}

impl Told {
    /// Tells the viewers why there is no daemon, or that there is one again.
    fn tell(&mut self, handle: &WebSocketServerHandle, viewers: usize, lost: Option<String>) {
        let is_news = lost != self.lost || viewers > self.viewers;
        match &lost {
            Some(why) if is_news => {
                handle.publish_status(Status::warning(format!("no daemon: {why}")).with_id(LOST));
            }
            None if is_news && self.lost.is_some() => handle.remove_status(vec![LOST.to_owned()]),
            _ => {}
        }
        *self = Self { viewers, lost };
    }
}
