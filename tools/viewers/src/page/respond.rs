//! Answers one request.

use std::{borrow::Cow, io, sync::Arc, time::Duration};

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
    feed::{Feed, Setup},
    request::{BadRequest, Request},
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
    let is_head = request.as_ref().is_ok_and(|it| it.method == "HEAD");
    let answer = match content(request, shared).await {
        Ok(Content::Events(viewer)) if !is_head => {
            write_all(write, head(OK, EVENTS, None).as_bytes()).await?;
            return Ok(Some(viewer));
        }
        Ok(Content::Events(_)) => head(OK, EVENTS, None),
        Ok(Content::Text(kind, text)) => {
            head(OK, kind, Some(text.len())) + if is_head { "" } else { &text }
        }
        Err((status, why)) => head(status, TEXT, Some(why.len() + 1)) + &why + "\n",
    };
    write_all(write, answer.as_bytes()).await?;
    write.shutdown().await?;
    linger(read).await;
    Ok(None)
}

/// What a request is answered with: a text of a type, or the events.
enum Content<'a> {
    Text(&'static str, Cow<'static, str>),
    Events(Viewer<'a>),
}

/// What a request asks for; or the status line, and why it is refused.
async fn content<'a>(
    request: Result<Request, BadRequest>,
    shared: &'a Shared,
) -> Result<Content<'a>, (&'static str, Cow<'static, str>)> {
    let refused = |status, why: &'static str| Err((status, Cow::from(why)));
    let request = match request {
        Ok(request) => request,
        Err(BadRequest::Malformed) => {
            return refused(BAD_REQUEST, "This is no request of HTTP.");
        }
        Err(BadRequest::TooLong) => {
            return refused(TOO_LONG, "The head of the request is too long.");
        }
    };
    if !matches!(request.method.as_str(), "GET" | "HEAD") {
        let why = "The page only shows. Commands go through the control socket.";
        return refused(METHOD_NOT_ALLOWED, why);
    }
    if shared.token.is_none() && !request.names_no_other_host() {
        let why = "Ask for the page by the address of the computer, or as localhost.";
        return refused(FORBIDDEN, why);
    }
    let path = request.path.as_str();
    if let Some((_, kind, text)) = ASSETS.into_iter().find(|(asset, ..)| *asset == path) {
        return Ok(Content::Text(kind, text.into()));
    }
    if !matches!(path, "/setup.json" | "/history.json" | "/events") {
        return refused(NOT_FOUND, "There is nothing at this path.");
    }
    if let Some(expected) = &shared.token
        && !request.token.is_some_and(|token| expected.is(&token))
    {
        let why =
            "The address of the page must end with ?token= and the token from page.token_file.";
        return refused(FORBIDDEN, why);
    }
    match path {
        "/setup.json" => match shared.setup.get().await {
            Ok(setup) => Ok(Content::Text(JSON, setup.to_string().into())),
            Err(why) => Err((BUSY, format!("No daemon: {why}").into())),
        },
        "/history.json" => {
            let history = json!(*shared.feed.history.borrow()).to_string();
            Ok(Content::Text(JSON, history.into()))
        }
        _ => match shared.places.try_acquire() {
            Ok(viewer) => Ok(Content::Events(viewer)),
            Err(_) => refused(BUSY, "Too many viewers watch; close one."),
        },
    }
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

fn head(status: &str, content_type: &str, length: Option<usize>) -> String {
    let length = length.map(|length| format!("Content-Length: {length}\r\n"));
    let length = length.unwrap_or_default();
    format!("HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\n{length}{HEADERS}\r\n")
}

async fn write_all(write: &mut OwnedWriteHalf, bytes: &[u8]) -> io::Result<()> {
    timeout(WRITE_TIMEOUT, write.write_all(bytes)).await?
}
