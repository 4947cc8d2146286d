//! Answers one request.

use core::fmt::Write as _;
use std::{io, sync::Arc, time::Duration};

use singletrack_access::linger;
use socket2::SockRef;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{
        TcpStream,
        tcp::{OwnedReadHalf, OwnedWriteHalf},
    },
    sync::watch,
    task::spawn_blocking,
    time::timeout,
};

use super::{
    assets::asset,
    feed::status,
    request::{BadRequest, Request},
    server::Shared,
    setup::setup,
};
use crate::state_stream::STATE_BUFFER;

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
#[derive(Clone, Copy)]
enum Code {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    TooLong,
    Busy,
}

impl Code {
    const fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed\r\nAllow: GET, HEAD",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::Busy => "503 Service Unavailable",
        }
    }
}

/// Reads a request, answers it and closes the connection.
pub(super) async fn serve(stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (mut read, mut write) = stream.into_split();
    let Some(request) = Request::read(&mut read).await? else {
        return Ok(());
    };
    answer(&mut read, &mut write, request, shared).await?;
    write.shutdown().await?;
    linger(&mut read).await;
    Ok(())
}

async fn answer(
    read: &mut OwnedReadHalf,
    write: &mut OwnedWriteHalf,
    request: Result<Request, BadRequest>,
    shared: &Shared,
) -> io::Result<()> {
    let request = match request {
        Ok(request) => request,
        Err(BadRequest::Malformed) => {
            return refuse(write, Code::BadRequest, "This is no request of HTTP.").await;
        }
        Err(BadRequest::TooLong) => {
            return refuse(write, Code::TooLong, "The head of the request is too long.").await;
        }
    };
    let with_body = match request.method.as_str() {
        "GET" => true,
        "HEAD" => false,
        _ => {
            let why = "The page only shows. Commands go through the control socket.";
            return refuse(write, Code::MethodNotAllowed, why).await;
        }
    };
    if shared.token.is_none() && !request.names_no_other_host() {
        let why = "Ask for the page by the address of the computer, or as localhost.";
        return refuse(write, Code::Forbidden, why).await;
    }
    if let Some(asset) = asset(&request.path) {
        return send(write, Code::Ok, asset.content_type, asset.bytes, with_body).await;
    }
    if !matches!(request.path.as_str(), "/setup.json" | "/events") {
        return refuse(write, Code::NotFound, "There is nothing at this path.").await;
    }
    if let Some(key) = &shared.token
        && !request.token.is_some_and(|token| key.token.is(&token))
    {
        let why =
            "The address of the page must end with ?token= and the token from page.token_file.";
        return refuse(write, Code::Forbidden, why).await;
    }
    if request.path == "/setup.json" {
        let reconfigurer = shared.daemon.reconfigurer.clone();
        let made = spawn_blocking(move || {
            let (number, config) = reconfigurer.in_force();
            setup(number, &config).to_string()
        });
        let body = made.await.map_err(io::Error::other)?;
        return send(write, Code::Ok, JSON, body.as_bytes(), with_body).await;
    }
    let Ok(_viewer) = shared.viewer() else {
        let why = "Too many viewers watch; close one.";
        return refuse(write, Code::Busy, why).await;
    };
    write_all(write, head(Code::Ok, EVENTS, None).as_bytes()).await?;
    if !with_body {
        return Ok(());
    }
    // A viewer sends no more. Reading detects that it has left.
    let mut rest = [0];
    tokio::select! {
        result = stream_events(write, shared) => result,
        closed = read.read(&mut rest) => closed.map(drop),
    }
}

/// Sends the newest events for as long as the viewer stays.
async fn stream_events(write: &mut OwnedWriteHalf, shared: &Shared) -> io::Result<()> {
    // What the kernel keeps is what a slow viewer is late by.
    SockRef::from(write.as_ref()).set_send_buffer_size(STATE_BUFFER)?;
    let mut states = shared.feed.states.subscribe();
    let mut statuses = shared.feed.statuses.subscribe();
    write_all(write, status(&shared.daemon).as_bytes()).await?;
    loop {
        let changed = tokio::select! {
            changed = statuses.changed() => changed.map(|()| newest(&mut statuses)),
            changed = states.changed() => changed.map(|()| newest(&mut states)),
        };
        // The feed lives as long as its viewers.
        let Ok(event) = changed else {
            return Ok(());
        };
        write_all(write, event.as_bytes()).await?;
    }
}

fn newest(events: &mut watch::Receiver<Arc<str>>) -> Arc<str> {
    Arc::clone(&events.borrow_and_update())
}

async fn refuse(write: &mut OwnedWriteHalf, code: Code, why: &str) -> io::Result<()> {
    send(write, code, TEXT, format!("{why}\n").as_bytes(), true).await
}

async fn send(
    write: &mut OwnedWriteHalf,
    code: Code,
    content_type: &str,
    body: &[u8],
    with_body: bool,
) -> io::Result<()> {
    write_all(write, head(code, content_type, Some(body.len())).as_bytes()).await?;
    if with_body {
        write_all(write, body).await?;
    }
    Ok(())
}

fn head(code: Code, content_type: &str, length: Option<usize>) -> String {
    let mut head = format!(
        "HTTP/1.1 {}\r\nContent-Type: {content_type}\r\n",
        code.line()
    );
    if let Some(length) = length {
        // Writing to a text does not fail.
        let _ = write!(head, "Content-Length: {length}\r\n");
    }
    head + HEADERS + "\r\n"
}

async fn write_all(write: &mut OwnedWriteHalf, bytes: &[u8]) -> io::Result<()> {
    timeout(WRITE_TIMEOUT, write.write_all(bytes)).await?
}
