//! The thread of the page: accepts browsers.

use std::{
    io,
    net::{SocketAddr, TcpListener as StdListener},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use singletrack_access::{Token, TokenFile};
use singletrack_core::config::PageSection;
use tokio::{
    net::TcpListener,
    runtime::{self, Runtime},
    sync::{Notify, Semaphore, SemaphorePermit, TryAcquireError},
};

use super::{feed::Feed, respond::serve, status::PageError};
use crate::{handle::DaemonHandle, live::LiveView};

/// The largest numbers of connections, and of viewers of the events among them, at a time.
const CONNECTIONS: usize = 96;
const VIEWERS: usize = 32;

/// The pause after a connection that could not be accepted: files may be closed soon.
const ERROR_PAUSE: Duration = Duration::from_millis(100);

/// A listening port, and its token.
#[derive(Debug)]
pub(crate) struct BoundPage {
    listener: StdListener,
    view: LiveView,
    key: Option<Key>,
}

/// The token, and the file that is removed with it.
#[derive(Debug)]
pub(super) struct Key {
    pub(super) token: Token,
    _file: TokenFile,
}

impl BoundPage {
    /// Listens, and writes the file of the token.
    pub(crate) fn open(section: &PageSection) -> Result<Self, PageError> {
        let address = SocketAddr::new(section.address, section.port);
        let failed = |source| PageError::Listen { address, source };
        let listener = StdListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let key = section.token_file.as_ref().map(|path| {
            let failed = |source| PageError::Token {
                path: path.clone(),
                source,
            };
            let token = Token::random().map_err(failed)?;
            let _file = TokenFile::create(path.clone(), address, &token).map_err(failed)?;
            Ok(Key { token, _file })
        });
        Ok(Self {
            listener,
            view: LiveView::new(address),
            key: key.transpose()?,
        })
    }

    /// For the status.
    pub(crate) fn view(&self) -> LiveView {
        self.view.clone()
    }
}

/// The server's thread.
#[derive(Debug)]
pub(crate) struct PageThread {
    stop: Arc<Notify>,
    thread: Option<JoinHandle<()>>,
}

impl PageThread {
    pub(crate) fn start(page: BoundPage, daemon: DaemonHandle) -> Result<Self, PageError> {
        let stop = Arc::new(Notify::new());
        let stopped = Arc::clone(&stop);
        let runtime = runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(PageError::Server)?;
        let (address, has_token) = (page.view.address(), page.key.is_some());
        let thread = thread::Builder::new()
            .name("page".to_owned())
            .spawn(move || run(runtime, page, daemon, &stopped))
            .map_err(PageError::Server)?;
        tracing::info!(%address, has_token, "page started");
        let thread = Some(thread);
        Ok(Self { stop, thread })
    }
}

impl Drop for PageThread {
    fn drop(&mut self) {
        self.stop.notify_one();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the page's thread has panicked");
        }
    }
}

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) daemon: DaemonHandle,
    pub(super) feed: Feed,
    pub(super) token: Option<Key>,
    places: Semaphore,
    viewers: Arc<AtomicU64>,
}

/// Counts a viewer for as long as it watches.
pub(super) struct Viewer<'a> {
    viewers: &'a AtomicU64,
    _place: SemaphorePermit<'a>,
}

impl Drop for Viewer<'_> {
    fn drop(&mut self) {
        self.viewers.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Shared {
    /// A place for a viewer of the events, if one is free.
    pub(super) fn viewer(&self) -> Result<Viewer<'_>, TryAcquireError> {
        let _place = self.places.try_acquire()?;
        self.viewers.fetch_add(1, Ordering::Relaxed);
        let viewers = &self.viewers;
        Ok(Viewer { viewers, _place })
    }
}

fn run(runtime: Runtime, page: BoundPage, daemon: DaemonHandle, stopped: &Notify) {
    let shared = Arc::new(Shared {
        daemon,
        feed: Feed::default(),
        token: page.key,
        places: Semaphore::new(VIEWERS),
        viewers: page.view.viewers(),
    });
    let listener = page.listener;
    runtime.block_on(async {
        tokio::select! {
            result = accept(listener, &shared) => {
                if let Err(error) = result {
                    tracing::error!(%error, "can't serve the page");
                }
            }
            () = shared.feed.run(&shared.daemon) => {}
            () = stopped.notified() => {}
        }
    });
    // Viewers are disconnected. A request that waits for a change of the configuration is not
    // waited for.
    runtime.shutdown_background();
}

/// Accepts browsers for as long as it is polled.
async fn accept(listener: StdListener, shared: &Arc<Shared>) -> io::Result<()> {
    let listener = TcpListener::from_std(listener)?;
    let connections = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        match listener.accept().await {
            Ok((stream, address)) => {
                // Beyond the limit it is closed without an answer.
                let Ok(place) = Arc::clone(&connections).try_acquire_owned() else {
                    continue;
                };
                let shared = Arc::clone(shared);
                tokio::spawn(async move {
                    // A browser may leave at any time.
                    if let Err(error) = serve(stream, &shared).await {
                        tracing::debug!(%address, %error, "browser disconnected");
                    }
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "browser not accepted");
                tokio::time::sleep(ERROR_PAUSE).await;
            }
        }
    }
}
