//! Accepts viewers and passes their bytes to the WebSocket server.
//!
//! The server of the protocol takes any number of clients, and stops to accept at the first
//! error, such as too many open files. It therefore listens on loopback only, at a port of the
//! system's choice, and this relay listens on the configured address.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU16, Ordering},
    },
    time::Duration,
};

use socket2::SockRef;
use tokio::{
    io::copy_bidirectional_with_sizes,
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore},
    time::{sleep, timeout},
};

/// The largest number of viewers at a time.
pub(super) const VIEWERS: usize = 8;

/// The longest wait for the first byte of a viewer.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(5);

/// The pause after a connection that could not be accepted: files may be closed soon.
const ERROR_PAUSE: Duration = Duration::from_millis(100);

/// Buffers of a viewer, in bytes: in the relay, and in the kernel for the way out. A viewer
/// that does not read occupies these, and the messages of the server that wait for it.
const FROM_VIEWER: usize = 1_024;
const TO_VIEWER: usize = 16_384;
const KERNEL: usize = 65_536;

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
    let mut has_warned = false;
    loop {
        match listener.accept().await {
            Ok((viewer, address)) => match Arc::clone(&slots).try_acquire_owned() {
                Ok(slot) => {
                    has_warned = false;
                    tokio::spawn(forward(viewer, address, inner.clone(), slot));
                }
                Err(_) => {
                    if !has_warned {
                        tracing::warn!(%address, "{VIEWERS} viewers are connected: no more are accepted");
                        has_warned = true;
                    }
                }
            },
            Err(error) => {
                if !has_warned {
                    tracing::warn!(%error, "viewer not accepted");
                    has_warned = true;
                }
                sleep(ERROR_PAUSE).await;
            }
        }
    }
}

/// Passes bytes in both directions until one side closes.
async fn forward(
    mut viewer: TcpStream,
    address: SocketAddr,
    inner: Inner,
    _slot: OwnedSemaphorePermit,
) {
    let result = async {
        SockRef::from(&viewer).set_send_buffer_size(KERNEL)?;
        viewer.set_nodelay(true)?;
        // A client that says nothing must not keep out the others.
        timeout(SILENCE_TIMEOUT, viewer.peek(&mut [0])).await??;
        let mut server = inner.connect().await?;
        SockRef::from(&server).set_recv_buffer_size(KERNEL)?;
        server.set_nodelay(true)?;
        copy_bidirectional_with_sizes(&mut viewer, &mut server, FROM_VIEWER, TO_VIEWER).await
    };
    // A viewer may leave at any time.
    if let Err(error) = result.await {
        tracing::debug!(%address, %error, "viewer disconnected");
    }
}
