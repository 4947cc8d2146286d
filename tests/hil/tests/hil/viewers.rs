//! Many viewers of the live view and of the page.

use std::{
    io::Write as _,
    net::{SocketAddr, TcpStream},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_hil::{Failure, Outcome, bench::Bench, client::Status, ensure};
use singletrack_statistics::Distribution;
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
];

/// As many as the daemon takes of the live view.
const VIEWERS: usize = 8;

/// Browsers on the page.
const BROWSERS: usize = 20;

/// Receive buffer of a viewer, in bytes: a few messages.
const RECEIVE_BUFFER: usize = 4_096;

/// Rounds with and without viewers alternate.
pub(crate) const ROUNDS: usize = 2;
const ROUND: Duration = Duration::from_secs(2);

/// Limit for the 99th percentile of the lateness; the processors are shared.
const LATENESS_LIMIT_US: f64 = 5_000.0;

/// Limit for the growth of the median lateness.
const MEDIAN_LIMIT: f64 = 2.0;

fn with_viewers(bench: &mut Bench) -> Outcome {
    let live = &mut bench.config_mut().live;
    live.enabled = true;
    live.port = 0;
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    disturb(bench, VIEWERS, Status::live, idle_viewer)
}

fn with_browsers(bench: &mut Bench) -> Outcome {
    let page = &mut bench.config_mut().page;
    page.enabled = true;
    page.port = 0;
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    disturb(bench, BROWSERS, Status::page, idle_browser)
}

/// Compares the lateness of a drive with that with `count` viewers of a server.
fn disturb<V>(
    bench: &mut Bench,
    count: usize,
    server: fn(&Status) -> Outcome<(SocketAddr, u64)>,
    viewer: fn(SocketAddr) -> Outcome<V>,
) -> Outcome {
    let (address, _) = server(&bench.status()?)?;
    let (mut alone, mut watched) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        lateness(bench, &mut alone)?;
        let viewers: Outcome<Vec<_>> = (0..count).map(|_| viewer(address)).collect();
        let viewers = viewers?;
        lateness(bench, &mut watched)?;
        let (_, connected) = server(&bench.status()?)?;
        ensure!(connected == count as u64, "{connected} viewers");
        drop(viewers);
    }
    compare(bench, alone, watched)
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
    Ok(stream)
}

/// Subscribes to everything and reads nothing.
fn idle_viewer(address: SocketAddr) -> Outcome<WebSocket<TcpStream>> {
    let stream = small_connection(address)?;
    let refused = |error: tungstenite::Error| Failure::new(format!("live view: {error}"));
    let mut request = format!("ws://{address}")
        .into_client_request()
        .map_err(refused)?;
    request.headers_mut().insert(
        "Sec-WebSocket-Protocol",
        tungstenite::http::HeaderValue::from_static("foxglove.sdk.v1"),
    );
    let (mut socket, _) = tungstenite::client(request, stream)
        .map_err(|error| Failure::new(format!("live view: {error}")))?;
    loop {
        let message = socket.read().map_err(refused)?;
        let Message::Text(text) = message else {
            continue;
        };
        let message: Value = serde_json::from_str(&text)
            .map_err(|error| Failure::new(format!("live view: {error}: {text}")))?;
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
