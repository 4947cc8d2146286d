//! The page, over TCP.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    os::unix::{
        fs::PermissionsExt,
        net::{UnixListener, UnixStream},
    },
    path::Path,
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::{Config, config::PageSection};
use singletrack_viewers::page::{OtherCar, Page};
use singletrackd::{Daemon, StartOptions};
use socket2::{Domain, Socket, Type};
use tempfile::TempDir;

use crate::common;

fn config(folder: &TempDir) -> Config {
    let mut config = common::config(folder.path());
    config.record.enabled = false;
    config
}

fn section() -> PageSection {
    PageSection {
        port: 0,
        ..PageSection::default()
    }
}

/// A page for the daemon of this folder.
fn page(folder: &TempDir) -> (Page, SocketAddr) {
    let page = Page::start(folder.path().join("control.sock"), Vec::new(), &section()).unwrap();
    let address = page.address;
    assert!(address.ip().is_loopback());
    (page, address)
}

/// A daemon and its page.
struct Beside {
    page: Page,
    daemon: Daemon,
    _folder: TempDir,
}

fn start() -> (Beside, SocketAddr) {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(config(&folder), StartOptions::default()).unwrap();
    let (page, address) = page(&folder);
    let beside = Beside {
        page,
        daemon,
        _folder: folder,
    };
    (beside, address)
}

/// Something that listens in place of a daemon.
fn listen(folder: &TempDir) -> UnixListener {
    UnixListener::bind(folder.path().join("control.sock")).unwrap()
}

/// The line of a client.
fn line_of(client: &UnixStream) -> String {
    let mut line = String::new();
    BufReader::new(client).read_line(&mut line).unwrap();
    line
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

/// The first line of the answer.
fn get_head(address: SocketAddr, path: &str) -> String {
    Viewer::on(connect(address), path).line()
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
    let (beside, address) = start();
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
    drop(beside.page);
    assert!(TcpStream::connect(address).is_err(), "it still listens");
}

#[test]
fn it_only_shows() {
    let (_beside, address) = start();
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
}

#[test]
fn another_name_of_this_computer_is_refused() {
    let (_beside, address) = start();
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
fn other_cars_are_shown_beside_as_long_as_their_daemons_answer() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let [first, second] = folders.each_ref().map(|folder| {
        let mut config = config(folder);
        config.motion_capture.rigid_body = folder.path().display().to_string();
        Daemon::start(config, StartOptions::default()).unwrap()
    });
    let [socket, other] = folders
        .each_ref()
        .map(|folder| folder.path().join("control.sock"));
    let nobody = folders[0].path().join("nobody.sock");
    let others = [(other, Some("teal".to_owned())), (nobody, None)];
    let others = others.map(|(socket, colour)| OtherCar { socket, colour });
    let page = Page::start(socket, others.into(), &section()).unwrap();
    let mut viewer = Viewer::connect(page.address);
    let mut shown = |is_wanted: fn(&Value) -> bool| loop {
        let others = viewer.event("state")["others"].take();
        assert_eq!(others[1], Value::Null);
        if is_wanted(&others[0]) {
            break others[0].clone();
        }
    };
    let other = shown(|other| !other.is_null());
    assert_eq!(
        other["car"]["name"],
        folders[1].path().display().to_string()
    );
    assert_eq!(other["mode"], "disconnected");
    assert_eq!(other["colour"], "teal");
    for key in [
        "corners_m",
        "hold_ms",
        "x_m",
        "y_m",
        "yaw_rad",
        "steering_rad",
        "pose_age_s",
    ] {
        assert!(other.get(key).is_some(), "{key}: {other}");
    }
    drop(second.stop());
    shown(Value::is_null);
    drop(first);
}

#[test]
fn a_viewer_gets_the_setup_the_status_and_the_newest_states() {
    let (_beside, address) = start();
    let (head, setup) = get(address, "/setup.json");
    assert!(head.contains("Content-Type: application/json"), "{head}");
    let setup: Value = serde_json::from_str(&setup).unwrap();
    assert_eq!(setup["fence"]["corners_m"][0], json!([-1.0, -1.0]));
    // Where the map shows the car that can begin.
    assert!(setup["start"]["x_m"].is_f64(), "{}", setup["start"]);
    let remedy = setup["reasons"]["host"]["link-down"]["remedy"]
        .as_str()
        .unwrap();
    assert!(remedy.starts_with("Plug the board in"), "{remedy}");

    let mut viewer = Viewer::connect(address);
    let status = viewer.event("status");
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
            "x_m",
            "point_m",
            "pose_age_s",
            "steering_rad",
            "board_age_s",
            "reference_m",
        ] {
            assert!(state.get(key).is_some(), "{key}");
        }
    }

    // Of the states, charts and trail are filled after a reload.
    drop(viewer);
    let mut viewer = Viewer::connect(address);
    viewer.event("state");
    let (_, history) = get(address, "/history.json");
    let history: Vec<Value> = serde_json::from_str(&history).unwrap();
    assert!(history.len() > 50, "{}", history.len());
    for state in &states {
        let kept = history.iter().find(|kept| kept["t_s"] == state["t_s"]);
        for (key, value) in kept.unwrap().as_object().unwrap() {
            assert_eq!(*value, state[key], "{key}");
        }
    }
}

#[test]
fn viewers_that_do_not_read_delay_no_other_and_then_see_the_newest() {
    let (beside, address) = start();
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
    let behind = beside.daemon.ticks() - last;
    assert!(behind < 100, "{behind} ticks behind");
    let summary = beside.daemon.snapshot().figures;
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
    let (_beside, address) = start();
    let mut viewers: Vec<_> = (0..32).map(|_| Viewer::connect(address)).collect();
    let (head, why) = get(address, "/events");
    assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
    assert!(why.contains("Too many viewers"), "{why}");
    for viewer in &mut viewers {
        viewer.event("state");
    }
    // The page itself comes all the same.
    assert!(get(address, "/").0.starts_with("HTTP/1.1 200 "));
    // A place is free again when its viewer has left.
    viewers.pop();
    common::wait_for("a free place", || {
        get_head(address, "/events").starts_with("HTTP/1.1 200 ")
    });
}

#[test]
fn what_is_secret_takes_the_token_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let _daemon = Daemon::start(config(&folder), StartOptions::default()).unwrap();
    let file = folder.path().join("page.token");
    let section = PageSection {
        token_file: Some(file.clone()),
        // Everywhere: that takes a token file.
        address: Ipv4Addr::UNSPECIFIED.into(),
        ..section()
    };
    let page = Page::start(folder.path().join("control.sock"), Vec::new(), &section).unwrap();
    let address = page.address;
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
    for path in ["/setup.json", "/history.json", "/events"] {
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
    viewer.event("status");
    assert_eq!(viewer.event("state")["mode"], "disconnected");
    drop(page);
    assert!(!file.exists());
}

#[test]
fn a_page_that_cannot_be_served_is_refused_with_what_to_change() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let refused = |section: PageSection, parts: &[&str]| {
        let error =
            Page::start(folder.path().join("control.sock"), Vec::new(), &section).unwrap_err();
        for part in parts {
            assert!(error.contains(part), "{error}");
        }
        error
    };
    let address = taken.local_addr().unwrap();
    let port = address.port();
    refused(
        PageSection { port, ..section() },
        &[&address.to_string(), "page.port"],
    );
    let token_file = Some(folder.path().join("missing/token"));
    refused(
        PageSection {
            token_file,
            ..section()
        },
        &["missing/token", "page.token_file"],
    );
    let address = Ipv4Addr::UNSPECIFIED.into();
    let error = refused(
        PageSection {
            address,
            ..section()
        },
        &["page.address", "0.0.0.0", "page.token_file"],
    );
    assert!(!error.contains("can't listen"), "{error}");
}

#[test]
fn a_daemon_that_restarts_is_found_again_and_its_end_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (_page, address) = page(&folder);
    // Without a daemon, the page itself is there, and says so.
    assert!(get(address, "/").0.starts_with("HTTP/1.1 200 "));
    let (head, why) = get(address, "/setup.json");
    assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
    assert!(
        why.starts_with("No daemon: ") && why.contains("control.sock"),
        "{why}"
    );
    let mut viewer = Viewer::connect(address);
    let lost = viewer.event("lost");
    assert!(lost.as_str().unwrap().contains("can't reach the daemon"));
    for radius in ["radius_m = 1.0", "radius_m = 0.9"] {
        let mut config = config(&folder);
        let text = config.to_toml().unwrap();
        assert!(text.contains("radius_m = 0.85"), "{text}");
        let changed = Config::from_toml(&text.replace("radius_m = 0.85", radius)).unwrap();
        config.reference = changed.reference;
        let daemon = Daemon::start(config, StartOptions::default()).unwrap();
        viewer.event("status");
        assert_eq!(viewer.event("state")["mode"], "disconnected");
        common::wait_for("the setup of this daemon", || {
            let (_, setup) = get(address, "/setup.json");
            let setup: Value = serde_json::from_str(&setup).unwrap_or_default();
            let [x, _]: [f64; 2] =
                serde_json::from_value(setup["reference"]["points_m"][0].clone())
                    .unwrap_or_default();
            (x - radius[11..].parse::<f64>().unwrap()).abs() < 1e-9
        });
        daemon.stop().unwrap();
        viewer.event("lost");
    }
}

/// Files of this process, and so of the page in it, are the limit of this number.
const LEAKED: usize = 300;

#[test]
fn connections_that_send_one_byte_keep_nobody_out() {
    let (_beside, address) = start();
    let leaked: Vec<_> = (0..LEAKED)
        .map(|_| {
            let mut stream = connect(address);
            stream.write_all(b"G").unwrap();
            stream
        })
        .collect();
    let begin = Instant::now();
    assert!(get(address, "/").0.starts_with("HTTP/1.1 200 "));
    assert!(get(address, "/setup.json").0.starts_with("HTTP/1.1 200 "));
    Viewer::connect(address).event("state");
    // Not by waiting until they have had their time.
    assert!(begin.elapsed() < Duration::from_secs(4));
    // The oldest ones have lost their places.
    for mut stream in leaked.into_iter().take(LEAKED - 96) {
        assert_eq!(stream.read(&mut [0]).unwrap_or(0), 0);
    }
}

/// The answer to `configuration`.
fn configuration(folder: &Path) -> String {
    let toml = common::config(folder).to_toml().unwrap();
    json!({ "version": 3, "ok": true, "configuration": 1, "toml": toml }).to_string()
}

#[test]
fn a_setup_that_96_browsers_ask_for_together_is_made_once() {
    let folder = tempfile::tempdir().unwrap();
    let listener = listen(&folder);
    let (_page, address) = page(&folder);
    let mut asking: Vec<_> = (0..96).map(|_| connect(address)).collect();
    for stream in &mut asking {
        let request = "GET /setup.json HTTP/1.1\r\nHost: localhost\r\n\r\n";
        stream.write_all(request.as_bytes()).unwrap();
    }
    let (mut client, _) = listener.accept().unwrap();
    assert!(line_of(&client).contains("configuration"));
    writeln!(client, "{}", configuration(folder.path())).unwrap();
    let mut bodies: Vec<_> = asking
        .into_iter()
        .map(|mut stream| {
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
            answer.split_once("\r\n\r\n").unwrap().1.to_owned()
        })
        .collect();
    bodies.dedup();
    assert_eq!(bodies.len(), 1);
    listener.set_nonblocking(true).unwrap();
    assert!(listener.accept().is_err(), "it was asked again");
}

#[test]
fn a_daemon_that_hangs_holds_up_no_request_for_long() {
    let folder = tempfile::tempdir().unwrap();
    // It never accepts.
    let _listener = listen(&folder);
    let (_page, address) = page(&folder);
    let mut viewer = Viewer::connect(address);
    let asking: Vec<_> = (0..20)
        .map(|_| thread::spawn(move || get(address, "/setup.json")))
        .collect();
    assert!(get(address, "/").0.starts_with("HTTP/1.1 200 "));
    for asked in asking {
        let (head, why) = asked.join().unwrap();
        assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
        assert!(why.contains("no answer from the daemon"), "{why}");
    }
    let lost = viewer.event("lost");
    assert!(lost.as_str().unwrap().contains("no answer"), "{lost}");
}

#[test]
fn the_daemon_is_watched_for_as_long_as_a_browser_may_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let listener = listen(&folder);
    let (_page, address) = page(&folder);
    let viewer = Viewer::connect(address);
    let (mut watched, _) = listener.accept().unwrap();
    assert!(line_of(&watched).contains("watch"));
    watched.write_all(b"{\"version\":3,\"ok\":true}\n").unwrap();
    let (mut asked, _) = listener.accept().unwrap();
    assert!(line_of(&asked).contains("status"));
    asked
        .write_all(b"{\"version\":3,\"ok\":true,\"status\":{}}\n")
        .unwrap();
    drop(viewer);
    let begin = Instant::now();
    thread::spawn(move || {
        for asked in listener.incoming().map_while(Result::ok) {
            line_of(&asked);
            let answer = b"{\"version\":3,\"ok\":true,\"status\":{}}\n";
            (&asked).write_all(answer).unwrap();
        }
    });
    assert_eq!(watched.read(&mut [0]).unwrap(), 0, "it hangs up");
    assert!(begin.elapsed() > Duration::from_secs(4));
}

#[test]
fn a_refusal_is_shown_and_not_repeated_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let listener = listen(&folder);
    let (_page, address) = page(&folder);
    let mut viewer = Viewer::connect(address);
    let (mut refused, _) = listener.accept().unwrap();
    line_of(&refused);
    refused
        .write_all(b"{\"version\":3,\"ok\":false,\"error\":\"24 clients watch\"}\n")
        .unwrap();
    assert_eq!(viewer.event("lost"), "24 clients watch");
    let begin = Instant::now();
    listener.accept().unwrap();
    assert!(begin.elapsed() > Duration::from_secs(5));
}
