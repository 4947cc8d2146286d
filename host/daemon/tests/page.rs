//! The page of a daemon without board and cameras, over TCP.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    os::unix::fs::PermissionsExt,
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::{Config, config::PageSection};
use singletrackd::{Daemon, StartError, StartOptions};
use socket2::{Domain, Socket, Type};
use tempfile::TempDir;

use crate::common;

fn config(folder: &TempDir) -> Config {
    let mut config = common::config(folder.path());
    config.record.enabled = false;
    config.page = PageSection {
        enabled: true,
        port: 0,
        ..PageSection::default()
    };
    config
}

fn start() -> (Daemon, SocketAddr, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(config(&folder), StartOptions::default()).unwrap();
    let address = daemon.snapshot().page.unwrap().address;
    assert!(address.ip().is_loopback());
    (daemon, address, folder)
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    stream
}

/// The head and the body of the answer to a request.
fn ask(address: SocketAddr, request: &str) -> (String, String) {
    let mut stream = connect(address);
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.to_owned(), body.to_owned())
}

fn get(address: SocketAddr, path: &str) -> (String, String) {
    ask(
        address,
        &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n"),
    )
}

/// A browser that watches.
struct Viewer(BufReader<TcpStream>);

impl Viewer {
    fn on(mut stream: TcpStream, path: &str) -> Self {
        let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        Self(BufReader::new(stream))
    }

    fn connect(address: SocketAddr) -> Self {
        let mut viewer = Self::on(connect(address), "/events");
        assert_eq!(viewer.line(), "HTTP/1.1 200 OK");
        viewer
    }

    /// A viewer whose kernel takes little that is not read.
    fn connect_slowly(address: SocketAddr) -> Self {
        let socket = Socket::new(Domain::for_address(address), Type::STREAM, None).unwrap();
        socket.set_recv_buffer_size(2_048).unwrap();
        socket.connect(&address.into()).unwrap();
        let stream = TcpStream::from(socket);
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        Self::on(stream, "/events")
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        assert!(self.0.read_line(&mut line).unwrap() > 0, "closed");
        line.trim_end().to_owned()
    }

    /// The data of the next event with this name.
    fn event(&mut self, name: &str) -> Value {
        while self.line() != format!("event: {name}") {}
        let line = self.line();
        let data = line.strip_prefix("data: ").unwrap();
        assert_eq!(self.line(), "", "the end of the event");
        serde_json::from_str(data).unwrap()
    }
}

#[test]
fn the_page_is_whole_and_loads_nothing_from_elsewhere() {
    let (daemon, address, _folder) = start();
    let (head, page) = get(address, "/");
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
    assert!(head.contains("Content-Type: text/html"), "{head}");
    assert!(head.contains("default-src 'none'"), "{head}");
    for part in ["role=\"status\"", "aria-live=\"polite\"", "lang=\"en\""] {
        assert!(page.contains(part), "{part}");
    }
    let mut bytes = page.len();
    for (path, content_type) in [
        ("/page.css", "text/css"),
        ("/page.js", "text/javascript"),
        ("/view.js", "text/javascript"),
        ("/chart.js", "text/javascript"),
        ("/icon.svg", "image/svg+xml"),
    ] {
        assert!(page.contains(&path[1..]) || path == "/view.js" || path == "/chart.js");
        let (head, body) = get(address, path);
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{path}: {head}");
        assert!(head.contains(content_type), "{path}: {head}");
        assert!(head.contains(&format!("Content-Length: {}\r\n", body.len())));
        // The name of SVG's elements is no place to load something from.
        let body = body.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
        assert!(!body.contains("://"), "{path}");
        bytes += body.len();
    }
    assert!(bytes < 50_000, "{bytes} bytes");
    daemon.stop().unwrap();
    assert!(TcpStream::connect(address).is_err(), "it still listens");
}

#[test]
fn it_only_shows() {
    let (daemon, address, _folder) = start();
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        for path in ["/", "/events", "/setup.json", "/nothing"] {
            let (head, _) = ask(
                address,
                &format!(
                    "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\n\r\nstop"
                ),
            );
            assert!(head.starts_with("HTTP/1.1 405 "), "{method} {path}: {head}");
            assert!(head.contains("Allow: GET, HEAD\r\n"), "{head}");
        }
    }
    for path in ["/nothing", "/../Cargo.toml", "/page.js/", "//"] {
        let (head, _) = get(address, path);
        assert!(head.starts_with("HTTP/1.1 404 "), "{path}: {head}");
    }
    let (head, body) = ask(address, "HEAD / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200 ") && body.is_empty());
    let (head, _) = ask(address, "what is this\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 400 "), "{head}");
    let (head, _) = ask(address, &format!("GET /{} ", "a".repeat(9_000)));
    assert!(head.starts_with("HTTP/1.1 431 "), "{head}");
    daemon.stop().unwrap();
}

#[test]
fn another_name_of_this_computer_is_refused() {
    let (_daemon, address, _folder) = start();
    for path in ["/", "/setup.json", "/events"] {
        let (head, _) = ask(
            address,
            &format!(
                "GET {path} HTTP/1.1\r\nHost: evil.example:{}\r\n\r\n",
                address.port()
            ),
        );
        assert!(head.starts_with("HTTP/1.1 403 "), "{path}: {head}");
    }
}

#[test]
fn a_viewer_gets_the_setup_the_status_and_the_newest_states() {
    let (daemon, address, _folder) = start();
    let (head, setup) = get(address, "/setup.json");
    assert!(head.contains("Content-Type: application/json"), "{head}");
    let setup: Value = serde_json::from_str(&setup).unwrap();
    assert_eq!(setup["fence"]["corners_m"][0], json!([-1.0, -1.0]));
    let remedy = setup["reasons"]["host"]["link-down"]["remedy"]
        .as_str()
        .unwrap();
    assert!(remedy.starts_with("Plug the board in"), "{remedy}");

    let mut viewer = Viewer::connect(address);
    let status = viewer.event("status");
    assert_eq!(status["mode"], "disconnected");
    assert_eq!(status["page"]["viewers"], 1);
    assert_eq!(status["configuration"]["number"], setup["configuration"]);
    let begin = Instant::now();
    let states: Vec<_> = (0..50).map(|_| viewer.event("state")).collect();
    let took = begin.elapsed();
    // 50 states at 25 Hz take 2 s; a slow machine may take longer, but none is faster.
    assert!(took > Duration::from_millis(1_800), "{took:?}");
    let ticks: Vec<_> = states
        .iter()
        .map(|state| state["tick"].as_u64().unwrap())
        .collect();
    assert!(ticks.is_sorted_by(|a, b| a < b), "{ticks:?}");
    for state in &states {
        assert_eq!(state["topic"], "state");
        assert_eq!(state["mode"], "disconnected");
        assert!(state["reason"] == "link-down" || state["reason"].is_null());
        for key in [
            "x",
            "point",
            "pose_age",
            "steering",
            "board_age",
            "reference",
        ] {
            assert!(state.get(key).is_some(), "{key}");
        }
    }
    // A place is free again when its viewer has left.
    drop(viewer);
    let begin = Instant::now();
    while daemon.snapshot().page.unwrap().viewers > 0 {
        assert!(begin.elapsed() < Duration::from_secs(20));
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn viewers_that_do_not_read_delay_no_other_and_then_see_the_newest() {
    let (daemon, address, _folder) = start();
    let mut slow: Vec<_> = (0..20).map(|_| Viewer::connect_slowly(address)).collect();
    let mut viewer = Viewer::connect(address);
    let first = viewer.event("state")["tick"].as_u64().unwrap();
    let mut last = first;
    while last < first + 400 {
        let tick = viewer.event("state")["tick"].as_u64().unwrap();
        // 4 ticks if nothing is late.
        assert!(
            tick - last < 100,
            "{} ticks between two states",
            tick - last
        );
        last = tick;
    }
    let behind = daemon.ticks() - last;
    assert!(behind < 100, "{behind} ticks behind");
    let summary = daemon.snapshot().figures;
    assert_eq!(summary.dropped.reports, 0);
    // What the kernel kept for a slow one is old, and after that comes the present.
    for viewer in &mut slow {
        let mut tick = viewer.event("state")["tick"].as_u64().unwrap();
        let mut widest = 0;
        while tick < last {
            let next = viewer.event("state")["tick"].as_u64().unwrap();
            widest = widest.max(next - tick);
            tick = next;
        }
        assert!(widest > 50, "nothing was left out: {widest}");
    }
}

#[test]
fn thirty_two_viewers_watch_and_one_more_is_turned_away() {
    let (_daemon, address, _folder) = start();
    let mut viewers: Vec<_> = (0..32).map(|_| Viewer::connect(address)).collect();
    let (head, why) = get(address, "/events");
    assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
    assert!(why.contains("Too many viewers"), "{why}");
    for viewer in &mut viewers {
        viewer.event("state");
    }
    // The page itself comes all the same.
    assert!(get(address, "/").0.starts_with("HTTP/1.1 200 "));
}

#[test]
fn what_is_secret_takes_the_token_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("page.token");
    let mut config = config(&folder);
    config.page.token_file = Some(file.clone());
    // Everywhere: that takes a token file.
    config.page.address = Ipv4Addr::UNSPECIFIED.into();
    let daemon = Daemon::start(config, StartOptions::default()).unwrap();
    let address = daemon.snapshot().page.unwrap().address;
    let mode = fs::metadata(&file).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    let key: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    assert_eq!(key["port"], address.port());
    let token = key["token"].as_str().unwrap();

    let ask = |path: &str| {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, address.port()));
        ask(
            address,
            &format!("GET {path} HTTP/1.1\r\nHost: car.example\r\n\r\n"),
        )
    };
    assert!(
        ask("/").0.starts_with("HTTP/1.1 200 "),
        "the page asks for the token"
    );
    for path in ["/setup.json", "/events"] {
        let wrong = token.replace(|digit: char| digit.is_ascii_digit(), "f");
        for query in [
            "",
            "?token=",
            "?token=x",
            &format!("?token={wrong}"),
            &format!("?key={token}"),
        ] {
            let (head, why) = ask(&format!("{path}{query}"));
            assert!(head.starts_with("HTTP/1.1 403 "), "{path}{query}: {head}");
            assert!(why.contains("page.token_file"), "{why}");
            assert!(!why.contains(token));
        }
    }
    let (head, setup) = ask(&format!("/setup.json?token={token}"));
    assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
    assert!(!setup.contains(token));
    let local = SocketAddr::from((Ipv4Addr::LOCALHOST, address.port()));
    let mut viewer = Viewer::on(connect(local), &format!("/events?token={token}"));
    assert_eq!(viewer.event("status")["mode"], "disconnected");
    viewer.event("state");
    daemon.stop().unwrap();
    assert!(!file.exists());
}

#[test]
fn a_page_that_cannot_be_served_is_refused_with_what_to_change() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let refused = |change: &dyn Fn(&mut PageSection), parts: &[&str]| {
        let mut config = config(&folder);
        change(&mut config.page);
        let error = Daemon::start(config, StartOptions::default()).unwrap_err();
        let text = error.to_string();
        for part in parts {
            assert!(text.contains(part), "{text}");
        }
        error
    };
    let address = taken.local_addr().unwrap();
    let error = refused(
        &|page| page.port = address.port(),
        &[&address.to_string(), "page.port", "page.enabled = false"],
    );
    assert!(matches!(error, StartError::Page(_)));
    let error = refused(
        &|page| page.token_file = Some(folder.path().join("missing/token")),
        &["missing/token", "page.token_file"],
    );
    assert!(matches!(error, StartError::Page(_)));
    let error = refused(
        &|page| page.address = Ipv4Addr::UNSPECIFIED.into(),
        &["page.address", "0.0.0.0", "page.token_file"],
    );
    assert!(matches!(error, StartError::Config(_)));
}
