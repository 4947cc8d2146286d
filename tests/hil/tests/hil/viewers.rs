//! Many viewers of the live view and of the page, and what becomes of their processes.

use std::{
    fmt::Display,
    io::{BufRead as _, BufReader, Write as _},
    net::{SocketAddr, TcpStream},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_control::statistics::Distribution;
use singletrack_hil::{Failure, Outcome, bench::Bench, ensure, viewer::Viewer};
use socket2::{Domain, Socket, Type};
use tungstenite::{Message, WebSocket, client::IntoClientRequest};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "eight_viewers_that_never_read_do_not_affect_driving",
        with_viewers,
    )
    .alone(),
    Scenario::new(
        "twenty_browsers_that_never_read_do_not_affect_driving",
        with_browsers,
    )
    .alone(),
    Scenario::new(
        "a_page_and_a_live_view_that_hang_or_are_killed_do_not_affect_driving",
        with_servers_that_hang_and_die,
    )
    .alone(),
    Scenario::new(
        "fifty_pages_and_live_views_leave_the_socket_to_the_operator",
        with_fifty_servers,
    )
    .alone(),
];

/// Viewers of the live view.
const VIEWERS: usize = 8;

/// Browsers on the page.
const BROWSERS: usize = 20;

/// Processes that show a drive.
const SERVERS: usize = 50;

/// Receive buffer of a viewer, in bytes: a few messages.
const RECEIVE_BUFFER: usize = 4_096;

/// Rounds with and without viewers alternate.
pub(crate) const ROUNDS: usize = 2;
const ROUND: Duration = Duration::from_secs(2);

/// Limit for the 99th percentile of the lateness; the processors are shared.
const LATENESS_LIMIT_US: f64 = 5_000.0;

/// Limit for the growth of the median lateness.
const MEDIAN_LIMIT: f64 = 2.0;

/// Limit from a stop to neutral, as without viewers and for a machine that is busy with them.
const STOP_LIMIT_MS: f64 = 150.0;

fn with_viewers(bench: &mut Bench) -> Outcome {
    disturb(bench, "live", VIEWERS, idle_viewer)
}

fn with_browsers(bench: &mut Bench) -> Outcome {
    disturb(bench, "page", BROWSERS, idle_browser)
}

/// Compares the lateness of a drive with that with `count` viewers of a server.
fn disturb<V>(
    bench: &mut Bench,
    server: &str,
    count: usize,
    viewer: fn(SocketAddr) -> Outcome<V>,
) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let server = Viewer::start(server, bench)?;
    let (mut alone, mut watched) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        lateness(bench, &mut alone)?;
        let viewers: Outcome<Vec<_>> = (0..count).map(|_| viewer(server.address())).collect();
        let viewers = viewers?;
        lateness(bench, &mut watched)?;
        drop(viewers);
    }
    compare(bench, alone, watched)
}

fn with_servers_that_hang_and_die(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let (mut alone, mut watched) = (Vec::new(), Vec::new());
    lateness(bench, &mut alone)?;
    let (page, live) = (Viewer::start("page", bench)?, Viewer::start("live", bench)?);
    let _watching = (idle_browser(page.address())?, idle_viewer(live.address())?);
    page.pause()?;
    live.pause()?;
    // Longer than what the kernel keeps for them.
    for _ in 0..ROUNDS {
        lateness(bench, &mut watched)?;
    }
    drop((page, live));
    lateness(bench, &mut watched)?;
    bench.keep_driving(Duration::from_secs(1))?;
    compare(bench, alone, watched)
}

fn with_fifty_servers(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let servers: Outcome<Vec<_>> = (0..SERVERS)
        .map(|index| Viewer::start(["page", "live"][index % 2], bench))
        .collect();
    let servers = servers?;
    let (mut browsers, mut viewers) = (Vec::new(), Vec::new());
    for pair in servers.chunks_exact(2) {
        browsers.push(idle_browser(pair[0].address())?);
        viewers.push(mere_viewer(pair[1].address())?);
    }
    // Others are answered as without them.
    let begin = Instant::now();
    while begin.elapsed() < ROUND {
        bench.status()?;
    }
    let status = bench.status()?;
    ensure!(status.mode() == "driving", "{}", status.text());
    bench.at_most(
        "99th percentile of the ticks' lateness",
        status.figure("/lateness_us/p99")?,
        LATENESS_LIMIT_US,
        "us",
    )?;
    let stopped_us = bench.board_time_us()?;
    bench.client()?.stop()?.accepted()?;
    bench.neutral_within(
        "after a stop beside fifty viewers",
        stopped_us,
        STOP_LIMIT_MS,
    )?;
    drop((browsers, viewers, servers));
    bench.was_within_limits(&bench.rig().trace()?)
}

/// Compares the lateness of a drive with that with viewers, in us.
pub(crate) fn compare(bench: &mut Bench, alone: Vec<f64>, watched: Vec<f64>) -> Outcome {
    let status = bench.status()?;
    let lost = status.figure("/dropped/record_entries")?;
    ensure!(lost == 0.0, "the record lacks {lost} entries");
    let [alone, watched] = [alone, watched].map(|values| {
        let values = Distribution::of(values);
        [0.5, 0.99].map(|part| values.quantile(part).unwrap_or(f64::NAN))
    });
    bench.at_most(
        "median lateness of the ticks, relative to no viewers",
        watched[0] / alone[0],
        MEDIAN_LIMIT,
        "",
    )?;
    bench.at_most(
        "99th percentile of the ticks' lateness",
        watched[1],
        LATENESS_LIMIT_US,
        "us",
    )?;
    bench.was_within_limits(&bench.rig().trace()?)
}

/// Records the lateness of the ticks of a round, in us.
pub(crate) fn lateness(bench: &mut Bench, values: &mut Vec<f64>) -> Outcome {
    let mut ticks = bench.client()?.watch_ticks()?;
    let begin = Instant::now();
    while begin.elapsed() < ROUND {
        let [late_ns] = ticks.next_of(["lateness_ns"])?;
        let late_ns = late_ns.ok_or_else(|| Failure::new("a tick without lateness"))?;
        values.push(late_ns.max(1.0) * 1e-3);
    }
    Ok(())
}

/// A connection that takes little of what is not read. With a usual receive buffer, a viewer
/// would become slow only after 15 s.
fn small_connection(address: SocketAddr) -> Outcome<TcpStream> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, None)
        .map_err(Failure::system("no socket"))?;
    socket
        .set_recv_buffer_size(RECEIVE_BUFFER)
        .map_err(Failure::system("no small buffer"))?;
    socket
        .connect(&address.into())
        .map_err(Failure::system("no connection"))?;
    let stream = TcpStream::from(socket);
    stream
        .set_read_timeout(Some(Duration::from_secs(5)))
        .map_err(Failure::system("no time limit"))?;
    Ok(stream)
}

/// Watches the page's events and reads nothing.
fn idle_browser(address: SocketAddr) -> Outcome<TcpStream> {
    let mut stream = small_connection(address)?;
    let request = format!("GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n");
    stream
        .write_all(request.as_bytes())
        .map_err(Failure::system("no page"))?;
    let mut line = String::new();
    // One byte at a time: the rest stays unread.
    BufReader::with_capacity(1, &stream)
        .read_line(&mut line)
        .map_err(Failure::system("no answer of the page"))?;
    ensure!(line.starts_with("HTTP/1.1 200 "), "the page: {line}");
    Ok(stream)
}

fn refused(error: impl Display) -> Failure {
    Failure::new(format!("live view: {error}"))
}

/// A viewer without subscriptions: what its server gets of the daemon goes no further.
fn mere_viewer(address: SocketAddr) -> Outcome<WebSocket<TcpStream>> {
    let stream = small_connection(address)?;
    let mut request = format!("ws://{address}")
        .into_client_request()
        .map_err(refused)?;
    request.headers_mut().insert(
        "Sec-WebSocket-Protocol",
        tungstenite::http::HeaderValue::from_static("foxglove.sdk.v1"),
    );
    let (socket, _) = tungstenite::client(request, stream).map_err(refused)?;
    Ok(socket)
}

/// Subscribes to everything and reads nothing.
fn idle_viewer(address: SocketAddr) -> Outcome<WebSocket<TcpStream>> {
    let mut socket = mere_viewer(address)?;
    loop {
        let message = socket.read().map_err(refused)?;
        let Message::Text(text) = message else {
            continue;
        };
        let message: Value = serde_json::from_str(&text).map_err(refused)?;
        let Some(channels) = message["channels"].as_array() else {
            continue;
        };
        let subscriptions: Vec<_> = channels
            .iter()
            .enumerate()
            .map(|(id, channel)| json!({"id": id, "channelId": channel["id"]}))
            .collect();
        ensure!(!subscriptions.is_empty(), "the live view has no channels");
        let message = json!({"op": "subscribe", "subscriptions": subscriptions});
        socket
            .send(Message::text(message.to_string()))
            .map_err(refused)?;
        return Ok(socket);
    }
}
