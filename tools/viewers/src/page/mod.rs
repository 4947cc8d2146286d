//! The page for a browser, over HTTP.
//!
//! | path | content |
//! |---|---|
//! | `/` and its `.js`, `.css`, `.svg` | the page, which needs nothing from elsewhere |
//! | `/setup.json` | what does not change during a drive: geofence, path of the reference, name and size of the car, and the words of [`singletrack_core::reasons`] |
//! | `/history.json` | of the states of the last 20 s what charts and trail show; it is kept for 5 s without a viewer |
//! | `/events` | Server-Sent Events: `state`, the newest line of the state stream 25 times a second; `status`, that of the control socket once a second; and `lost`, why there is no daemon |
//!
//! It only shows: anything but GET and HEAD is refused. Beyond loopback, and wherever
//! `page.token_file` is set, the last three paths take the token. Without a token, a request must
//! name this computer by a number or as `localhost`: a web page elsewhere that gives its own
//! name this address learns nothing.
//!
//! A viewer that is slow to read gets fewer states, always the newest, and delays no other. A
//! connection that sends no whole request, or does not read its answer, gives way to newer ones.

mod feed;
mod respond;

use std::{
    io,
    net::{SocketAddr, TcpListener as StdListener},
    path::PathBuf,
    sync::Arc,
    time::Duration,
};

use singletrack_api::access::{Token, TokenFile, WaitingRoom};
use singletrack_core::config::PageSection;
use tokio::{net::TcpListener, runtime, sync::Semaphore, task::yield_now};

pub use self::{
    feed::OtherCar,
    respond::{BadRequest, Request},
};
use self::{
    feed::{Feed, Setup},
    respond::{Shared, serve},
};
use crate::{Follower, ServerThread};

/// The largest number of connections at a time that wait for an answer, or for a request. A newer
/// one takes the place of the oldest.
const CONNECTIONS: usize = 96;

/// The largest number of viewers of the events at a time.
const VIEWERS: usize = 32;

/// The pause after a connection that could not be accepted: files may be closed soon.
const ERROR_PAUSE: Duration = Duration::from_millis(100);

/// A page. It ends when this value is dropped.
#[derive(Debug)]
pub struct Page {
    /// The address that it listens on, with the port in use.
    pub address: SocketAddr,
    _server: ServerThread,
    _followers: Vec<Follower>,
    _token_file: Option<TokenFile>,
}

impl Page {
    /// Starts to listen, for the daemon at `socket`, which need not run; and writes the file of the
    /// token. The cars of `others` are shown beside.
    ///
    /// # Errors
    ///
    /// The address can't be listened on, or must not be without a token; the token can't be
    /// written; a thread does not start.
    pub fn start(
        socket: PathBuf,
        others: Vec<OtherCar>,
        section: &PageSection,
    ) -> Result<Self, String> {
        section.validate().map_err(|error| error.to_string())?;
        let address = SocketAddr::new(section.address, section.port);
        let failed = |error| {
            format!(
                "can't listen on {address} for the page: {error}; choose another page.address or \
                 page.port, or give --port"
            )
        };
        let listener = StdListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let key = section.token_file.as_ref().map(|path| {
            let failed = |error| {
                format!(
                    "can't write the token of the page to {}: {error}; choose a page.token_file \
                     in a folder that you may write to",
                    path.display()
                )
            };
            let token = Token::random().map_err(failed)?;
            let file = TokenFile::create(path.clone(), address, &token).map_err(failed)?;
            Ok::<_, String>((token, file))
        });
        let (token, token_file) = key.transpose()?.unzip();
        let shared = Arc::new(Shared {
            feed: Feed::new(others.len()),
            setup: Setup::default(),
            token,
            places: Semaphore::new(VIEWERS),
        });
        let started = || {
            let (followed, path) = (Arc::clone(&shared), socket.clone());
            let mut followers = vec![Follower::start(move || followed.feed.follow(&path))?];
            for (index, other) in others.into_iter().enumerate() {
                let followed = Arc::clone(&shared);
                let follow = move || followed.feed.follow_other(index, &other);
                followers.push(Follower::start(follow)?);
            }
            let runtime = runtime::Builder::new_current_thread()
                .enable_io()
                .enable_time()
                // For one question at a time.
                .max_blocking_threads(1)
                .build()?;
            let shared = Arc::clone(&shared);
            let server = ServerThread::start("page", move |stop| {
                runtime.block_on(async {
                    tokio::select! {
                        result = accept(listener, &shared) => {
                            if let Err(error) = result {
                                tracing::error!(%error, "can't serve the page");
                            }
                        }
                        () = shared.setup.run(&socket) => {}
                        () = stop.notified() => {}
                    }
                });
                // Viewers are disconnected. A daemon that does not answer is not waited for.
                runtime.shutdown_background();
            })?;
            Ok((server, followers))
        };
        let (server, followers) = started()
            .map_err(|error: io::Error| format!("the page's server does not start: {error}"))?;
        Ok(Self {
            address,
            _server: server,
            _followers: followers,
            _token_file: token_file,
        })
    }
}

/// Accepts browsers for as long as it is polled.
async fn accept(listener: StdListener, shared: &Arc<Shared>) -> io::Result<()> {
    let listener = TcpListener::from_std(listener)?;
    let room = WaitingRoom::new(CONNECTIONS);
    loop {
        match listener.accept().await {
            Ok((stream, address)) => {
                let (shared, place) = (Arc::clone(shared), room.enter());
                tokio::spawn(async move {
                    // A browser may leave at any time.
                    if let Err(error) = serve(stream, &shared, place).await {
                        tracing::debug!(%address, %error, "browser disconnected");
                    }
                });
                // Connections that lose their place are closed before there are more.
                yield_now().await;
            }
            Err(error) => {
                tracing::warn!(%error, "browser not accepted");
                tokio::time::sleep(ERROR_PAUSE).await;
            }
        }
    }
}
