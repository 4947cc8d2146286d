//! Reads the head of one request, and answers it.

use std::{borrow::Cow, io, net::IpAddr, sync::Arc, time::Duration};

use serde_json::json;
use singletrack_api::access::{Place, Token, linger};
use socket2::SockRef;
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWriteExt as _},
    net::{
        TcpStream,
        tcp::{OwnedReadHalf, OwnedWriteHalf},
    },
    sync::{Semaphore, SemaphorePermit, watch},
    time::timeout,
};

use super::feed::{Feed, Setup};

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

/// The longest head, in bytes.
const LONGEST_HEAD: usize = 8_192;

/// The longest wait for the whole head.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);

/// The largest number of headers.
const MOST_HEADERS: usize = 64;

/// What a browser asks the page for: the head of a request of HTTP/1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The method, such as `GET`.
    pub method: String,
    /// The path, without the query.
    pub path: String,
    /// `token` of the query.
    pub token: Option<String>,
    host: Option<String>,
}

/// Why a request is not answered with what it asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadRequest {
    /// It is no head of HTTP/1.
    Malformed,
    /// Its head, or the number of its headers, is beyond what a browser sends.
    TooLong,
}

impl Request {
    /// Reads a head. `None` if the client leaves or is silent before its end.
    async fn read(
        mut stream: impl AsyncRead + Unpin,
    ) -> io::Result<Option<Result<Self, BadRequest>>> {
        let mut head = Vec::new();
        let read = async {
            loop {
                match Self::parse(&head) {
                    Ok(None) if head.len() >= LONGEST_HEAD => {
                        return Ok(Some(Err(BadRequest::TooLong)));
                    }
                    Ok(None) => {}
                    parsed => return Ok(parsed.transpose()),
                }
                let room = LONGEST_HEAD.saturating_sub(head.len());
                if (&mut stream).take(room as u64).read_buf(&mut head).await? == 0 {
                    return Ok(None);
                }
            }
        };
        timeout(HEAD_TIMEOUT, read).await.unwrap_or(Ok(None))
    }

    /// The request, as soon as its head is complete; `None` before.
    ///
    /// # Errors
    ///
    /// When it is no head, or one with too many headers.
    pub fn parse(head: &[u8]) -> Result<Option<Self>, BadRequest> {
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(head) {
            Ok(httparse::Status::Complete(_)) => {}
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(httparse::Error::TooManyHeaders) => return Err(BadRequest::TooLong),
            Err(_) => return Err(BadRequest::Malformed),
        }
        let (Some(method), Some(target)) = (request.method, request.path) else {
            return Err(BadRequest::Malformed);
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let mut pairs = query.split('&');
        let token = pairs.find_map(|pair| pair.strip_prefix("token="));
        let mut headers = request.headers.iter();
        let host = headers.find(|header| header.name.eq_ignore_ascii_case("host"));
        let host = host.and_then(|header| str::from_utf8(header.value).ok());
        Ok(Some(Self {
            method: method.to_owned(),
            path: path.to_owned(),
            token: token.map(str::to_owned),
            host: host.map(|host| host.trim().to_owned()),
        }))
    }

    /// Whether the request names this computer by an address or as `localhost`, and not by a name
    /// that another web page may have given it.
    pub fn names_no_other_host(&self) -> bool {
        let Some(host) = &self.host else {
            // Browsers always name one.
            return true;
        };
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split_once(']').map_or("", |(name, _)| name),
            None => host.split(':').next().unwrap_or(host),
        };
        name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    fn parsed(head: &str) -> Result<Option<Request>, BadRequest> {
        Request::parse(head.as_bytes())
    }

    #[test]
    fn a_head_is_taken_apart_when_it_is_complete() {
        let head = "GET /events?a=1&token=abc HTTP/1.1\r\nhost: localhost:8767\r\n\r\n";
        for end in 0..head.len() {
            assert_eq!(parsed(&head[..end]), Ok(None), "{end}");
        }
        let request = parsed(head).unwrap().unwrap();
        assert_eq!(request.method, "GET");
        assert_eq!(request.path, "/events");
        assert_eq!(request.token.as_deref(), Some("abc"));
        assert!(request.names_no_other_host());
        assert_eq!(
            parsed("no request at all\r\n\r\n"),
            Err(BadRequest::Malformed)
        );
        let many = "X: y\r\n".repeat(MOST_HEADERS + 1);
        assert_eq!(
            parsed(&format!("GET / HTTP/1.1\r\n{many}\r\n")),
            Err(BadRequest::TooLong)
        );
    }

    #[test]
    fn only_addresses_and_localhost_are_this_computer() {
        let own = |host: &str| {
            let request = parsed(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n"));
            request.unwrap().unwrap().names_no_other_host()
        };
        for host in [
            "127.0.0.1:8767",
            "LOCALHOST",
            "localhost:1",
            "[::1]:8767",
            "10.0.0.7",
        ] {
            assert!(own(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8767",
            "127.0.0.1.evil.example",
            "[",
            "",
        ] {
            assert!(!own(host), "{host}");
        }
    }
}
