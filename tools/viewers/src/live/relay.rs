//! Accepts viewers and passes their bytes to the WebSocket server.
//!
//! The server of the protocol takes any number of clients, waits for their requests without a
//! limit, and stops to accept at the first error, such as too many open files. It therefore listens
//! on loopback only, at a port of the system's choice, and this relay listens on the configured
//! address.

use std::{
    io,
    net::Ipv4Addr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU16, Ordering},
    },
    time::Duration,
};

use singletrack_access::{Place, WaitingRoom, linger};
use socket2::SockRef;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _, BufReader, copy_buf},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    task::yield_now,
    time::sleep,
};

use crate::head::{LONGEST_HEAD, read_head};

/// The largest number of viewers at a time.
const VIEWERS: usize = 8;

/// The largest number of connections at a time whose request is not complete. A newer one takes the
/// place of the oldest.
const WAITING: usize = 32;

/// The pause after a connection that could not be accepted: files may be closed soon.
const ERROR_PAUSE: Duration = Duration::from_millis(100);

/// Buffers of a viewer, in bytes: in the relay, and in the kernel for the way out. A viewer
/// that does not read occupies these, and the messages of the server that wait for it.
const FROM_VIEWER: usize = 1_024;
const TO_VIEWER: usize = 16_384;
const KERNEL: usize = 65_536;

/// What a viewer may send in all, in bytes: subscriptions. The server collects a message up to its
/// end, however large the viewer says it is.
const ALL_FROM_VIEWER: u64 = 1 << 20;

/// The answer to a viewer beyond [`VIEWERS`].
const BUSY: &[u8] = b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\n\
    Connection: close\r\n\r\nToo many viewers are connected; close one.\n";

/// The protocol of older viewers, and that of the server.
const OLD_PROTOCOL: &str = "foxglove.websocket.v1";
const PROTOCOL: &str = "foxglove.sdk.v1";

/// The answer to a viewer that only speaks the old protocol.
const OLD: &[u8] = b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\n\
    Connection: close\r\n\r\nThis viewer is too old: it does not speak foxglove.sdk.v1. Update it.\n";

/// The WebSocket server behind the relay.
#[derive(Clone, Debug, Default)]
pub(super) struct Inner {
    port: Arc<AtomicU16>,
    has_ended: Arc<AtomicBool>,
}

impl Inner {
    /// The server listens on this port of loopback.
    pub(super) fn listens(&self, port: u16) {
        self.port.store(port, Ordering::Release);
    }

    /// True once after the server was found to accept no more.
    pub(super) fn take_ended(&self) -> bool {
        self.has_ended.swap(false, Ordering::AcqRel)
    }

    async fn connect(&self) -> io::Result<TcpStream> {
        let address = (Ipv4Addr::LOCALHOST, self.port.load(Ordering::Acquire));
        let result = TcpStream::connect(address).await;
        if let Err(error) = &result
            && error.kind() == io::ErrorKind::ConnectionRefused
        {
            self.has_ended.store(true, Ordering::Release);
        }
        result
    }
}

/// Accepts viewers for as long as the runtime lives.
pub(super) async fn relay(listener: TcpListener, inner: Inner) {
    let slots = Arc::new(Semaphore::new(VIEWERS));
    let room = WaitingRoom::new(WAITING);
    let mut has_warned = false;
    loop {
        match listener.accept().await {
            Ok((viewer, address)) => {
                has_warned = false;
                let (slots, inner, place) = (Arc::clone(&slots), inner.clone(), room.enter());
                tokio::spawn(async move {
                    // A viewer may leave at any time.
                    if let Err(error) = serve(viewer, &inner, &slots, place).await {
                        tracing::debug!(%address, %error, "viewer disconnected");
                    }
                });
                // Connections that lose their place are closed before there are more.
                yield_now().await;
            }
            Err(error) => not_accepted(&error, &mut has_warned).await,
        }
    }
}

async fn not_accepted(error: &io::Error, has_warned: &mut bool) {
    if !*has_warned {
        tracing::warn!(%error, "viewer not accepted");
        *has_warned = true;
    }
    sleep(ERROR_PAUSE).await;
}

/// Reads a viewer's request, and passes bytes in both directions until one side closes.
async fn serve(
    mut viewer: TcpStream,
    inner: &Inner,
    slots: &Semaphore,
    mut place: Place,
) -> io::Result<()> {
    SockRef::from(&viewer).set_send_buffer_size(KERNEL)?;
    viewer.set_nodelay(true)?;
    let Some(head) = place.until_lost(read_head(&mut viewer, is_whole)).await else {
        return Ok(());
    };
    let Some((true, head)) = head? else {
        return Ok(());
    };
    let slot = slots.try_acquire();
    let is_old = is_old(&head);
    if is_old {
        tracing::warn!(
            "a viewer that only speaks {OLD_PROTOCOL} is turned away: update it to one that speaks \
             {PROTOCOL}, or use `singletrack page`"
        );
    }
    let (Ok(_slot), false) = (slot, is_old) else {
        viewer.write_all(if is_old { OLD } else { BUSY }).await?;
        viewer.shutdown().await?;
        place.until_lost(linger(&mut viewer)).await;
        return Ok(());
    };
    drop(place);
    let mut server = inner.connect().await?;
    SockRef::from(&server).set_recv_buffer_size(KERNEL)?;
    server.set_nodelay(true)?;
    server.write_all(&head).await?;
    let (from_viewer, mut to_viewer) = viewer.split();
    let (from_server, mut to_server) = server.split();
    let mut from_viewer = BufReader::with_capacity(FROM_VIEWER, from_viewer.take(ALL_FROM_VIEWER));
    let mut from_server = BufReader::with_capacity(TO_VIEWER, from_server);
    tokio::select! {
        copied = copy_buf(&mut from_viewer, &mut to_server) => copied,
        copied = copy_buf(&mut from_server, &mut to_viewer) => copied,
    }
    .map(drop)
}

/// Whether a request is whole; false if it is too long, and `None` before its end.
fn is_whole(head: &[u8]) -> Option<bool> {
    let ends = head.windows(4).any(|bytes| bytes == b"\r\n\r\n");
    (ends || head.len() >= LONGEST_HEAD).then_some(ends)
}

/// Whether a request offers the old protocol and not the present one.
fn is_old(head: &[u8]) -> bool {
    let offers = |protocol: &str| {
        head.split(|byte| *byte == b'\n').any(|line| {
            let line = String::from_utf8_lossy(line).to_ascii_lowercase();
            line.starts_with("sec-websocket-protocol:") && line.contains(protocol)
        })
    };
    offers(OLD_PROTOCOL) && !offers(PROTOCOL)
}
