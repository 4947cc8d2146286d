//! Answers one request.

use core::fmt::Write as _;
use std::{io, sync::Arc, time::Duration};

use serde_json::json;
use singletrack_api::access::{Place, Token, linger};
use socket2::SockRef;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{
        TcpStream,
        tcp::{OwnedReadHalf, OwnedWriteHalf},
    },
    sync::{Semaphore, SemaphorePermit, watch},
    time::timeout,
};

use super::{
    feed::Feed,
    request::{BadRequest, Request},
    setup::Setup,
};

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// The files of the page: path, type of the content, text.
const ASSETS: [(&str, &str, &str); 6] = [
    ("/", HTML, include_str!("assets/index.html")),
    ("/page.css", CSS, include_str!("assets/page.css")),
    ("/page.js", SCRIPT, include_str!("assets/page.js")),
    ("/view.js", SCRIPT, include_str!("assets/view.js")),
    ("/chart.js", SCRIPT, include_str!("assets/chart.js")),
    ("/icon.svg", SVG, include_str!("assets/icon.svg")),
];

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) feed: Feed,
    pub(super) setup: Setup,
    pub(super) token: Option<Token>,
    /// For viewers of the events.
    pub(super) places: Semaphore,
}

/// Bytes of the kernel's buffer of a viewer; the kernel doubles it. What it keeps is what a slow
/// viewer is late by.
const STATE_BUFFER: usize = 4_096;

/// The longest time from a connection to the end of its answer.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);

/// The longest time that a viewer may read nothing at all.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);

const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";
const EVENTS: &str = "text/event-stream; charset=utf-8";

/// For every answer. The page loads nothing from elsewhere, and nothing else loads the page.
const HEADERS: &str = "\
Cache-Control: no-store\r\n\
Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; \
img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
Cross-Origin-Resource-Policy: same-origin\r\n\
Referrer-Policy: no-referrer\r\n\
X-Content-Type-Options: nosniff\r\n\
Connection: close\r\n";

/// The status lines in use.
const OK: &str = "200 OK";
const BAD_REQUEST: &str = "400 Bad Request";
const FORBIDDEN: &str = "403 Forbidden";
const NOT_FOUND: &str = "404 Not Found";
const METHOD_NOT_ALLOWED: &str = "405 Method Not Allowed\r\nAllow: GET, HEAD";
const TOO_LONG: &str = "431 Request Header Fields Too Large";
const BUSY: &str = "503 Service Unavailable";

/// The place of a viewer of the events.
type Viewer<'a> = SemaphorePermit<'a>;

/// Reads a request, answers it and closes the connection. An answer that takes too long, and one
/// whose place is taken, is cut off; events have places of their own.
pub(super) async fn serve(stream: TcpStream, shared: &Shared, mut place: Place) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (mut read, mut write) = stream.into_split();
    let brief = timeout(REQUEST_TIMEOUT, brief(&mut read, &mut write, shared));
    let Some(Ok(answered)) = place.until_lost(brief).await else {
        return Ok(());
    };
    let Some(_viewer) = answered? else {
        return Ok(());
    };
    drop(place);
    // A viewer sends no more. Reading detects that it has left.
    let mut rest = [0];
    tokio::select! {
        result = stream_events(&mut write, shared) => result,
        closed = read.read(&mut rest) => closed.map(drop),
    }
}

/// Serves all of a request, but for the events. Returns the viewer that they are for.
async fn brief<'a>(
    read: &mut OwnedReadHalf,
    write: &mut OwnedWriteHalf,
    shared: &'a Shared,
) -> io::Result<Option<Viewer<'a>>> {
    let Some(request) = Request::read(&mut *read).await? else {
        return Ok(None);
    };
    let viewer = answer(write, request, shared).await?;
    if viewer.is_none() {
        write.shutdown().await?;
        linger(read).await;
    }
    Ok(viewer)
}

async fn answer<'a>(
    write: &mut OwnedWriteHalf,
    request: Result<Request, BadRequest>,
    shared: &'a Shared,
) -> io::Result<Option<Viewer<'a>>> {
    let request = match request {
        Ok(request) => request,
        Err(BadRequest::Malformed) => {
            return refuse(write, BAD_REQUEST, "This is no request of HTTP.").await;
        }
        Err(BadRequest::TooLong) => {
            return refuse(write, TOO_LONG, "The head of the request is too long.").await;
        }
    };
    let with_body = match request.method.as_str() {
        "GET" => true,
        "HEAD" => false,
        _ => {
            let why = "The page only shows. Commands go through the control socket.";
            return refuse(write, METHOD_NOT_ALLOWED, why).await;
        }
    };
    if shared.token.is_none() && !request.names_no_other_host() {
        let why = "Ask for the page by the address of the computer, or as localhost.";
        return refuse(write, FORBIDDEN, why).await;
    }
    if let Some((_, kind, text)) = ASSETS.into_iter().find(|(path, ..)| *path == request.path) {
        return send(write, OK, kind, text.as_bytes(), with_body).await;
    }
    if !matches!(
        request.path.as_str(),
        "/setup.json" | "/history.json" | "/events"
    ) {
        return refuse(write, NOT_FOUND, "There is nothing at this path.").await;
    }
    if let Some(expected) = &shared.token
        && !request.token.is_some_and(|token| expected.is(&token))
    {
        let why =
            "The address of the page must end with ?token= and the token from page.token_file.";
        return refuse(write, FORBIDDEN, why).await;
    }
    if request.path == "/setup.json" {
        return match shared.setup.get().await {
            Ok(setup) => send(write, OK, JSON, setup.as_bytes(), with_body).await,
            Err(why) => refuse(write, BUSY, &format!("No daemon: {why}")).await,
        };
    }
    if request.path == "/history.json" {
        let history = json!(*shared.feed.history()).to_string();
        return send(write, OK, JSON, history.as_bytes(), with_body).await;
    }
    let Ok(viewer) = shared.places.try_acquire() else {
        let why = "Too many viewers watch; close one.";
        return refuse(write, BUSY, why).await;
    };
    write_all(write, head(OK, EVENTS, None).as_bytes()).await?;
    Ok(with_body.then_some(viewer))
}

/// Sends the newest events for as long as the viewer stays.
async fn stream_events(write: &mut OwnedWriteHalf, shared: &Shared) -> io::Result<()> {
    SockRef::from(write.as_ref()).set_send_buffer_size(STATE_BUFFER)?;
    let mut states = shared.feed.states.subscribe();
    let mut statuses = shared.feed.statuses.subscribe();
    let mut event = newest(&mut statuses);
    loop {
        write_all(write, event.as_bytes()).await?;
        let changed = tokio::select! {
            changed = statuses.changed() => changed.map(|()| newest(&mut statuses)),
            changed = states.changed() => changed.map(|()| newest(&mut states)),
        };
        // The feed lives as long as its viewers.
        let Ok(changed) = changed else {
            return Ok(());
        };
        event = changed;
    }
}

fn newest(events: &mut watch::Receiver<Arc<str>>) -> Arc<str> {
    Arc::clone(&events.borrow_and_update())
}

async fn refuse<'a>(
    write: &mut OwnedWriteHalf,
    status: &str,
    why: &str,
) -> io::Result<Option<Viewer<'a>>> {
    send(write, status, TEXT, format!("{why}\n").as_bytes(), true).await
}

/// Sends a whole answer: nobody watches.
async fn send<'a>(
    write: &mut OwnedWriteHalf,
    status: &str,
    content_type: &str,
    body: &[u8],
    with_body: bool,
) -> io::Result<Option<Viewer<'a>>> {
    write_all(
        write,
        head(status, content_type, Some(body.len())).as_bytes(),
    )
    .await?;
    if with_body {
        write_all(write, body).await?;
    }
    Ok(None)
}

fn head(status: &str, content_type: &str, length: Option<usize>) -> String {
    let mut head = format!("HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\n");
    if let Some(length) = length {
        // Writing to a text does not fail.
        let _ = write!(head, "Content-Length: {length}\r\n");
    }
    head + HEADERS + "\r\n"
}

async fn write_all(write: &mut OwnedWriteHalf, bytes: &[u8]) -> io::Result<()> {
    timeout(WRITE_TIMEOUT, write.write_all(bytes)).await?
}
