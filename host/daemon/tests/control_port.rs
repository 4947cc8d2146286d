//! The control socket on TCP, of a daemon without board and cameras.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    collections::HashSet,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream},
    os::unix::{fs::PermissionsExt, net::UnixStream},
    path::{Path, PathBuf},
    process::{Child, Command},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::Config;
use singletrack_pilot::Mode;
use singletrackd::{Daemon, StartOptions};
use tempfile::TempDir;

use crate::common;

const STATUS: &str = r#"{"version":3,"command":"status"}"#;
const STOP: &str = r#"{"version":3,"command":"stop"}"#;
const WATCH: &str = r#"{"version":3,"command":"watch","topics":["drops"]}"#;

fn config(folder: &Path) -> Config {
    let mut config = common::config(folder);
    config.socket.tcp_port = Some(0);
    config
}

/// A daemon with a port, and what the file of its token says.
struct Bench {
    daemon: Daemon,
    key: Value,
    folder: TempDir,
}

impl Bench {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let daemon = Daemon::start(config(folder.path()), StartOptions::default()).unwrap();
        let key = fs::read(token_file(folder.path())).unwrap();
        Self {
            daemon,
            key: serde_json::from_slice(&key).unwrap(),
            folder,
        }
    }

    fn token_line(&self) -> String {
        json!({"version": 3, "command": "token", "token": self.key["token"]}).to_string()
    }

    /// A connection that has said nothing.
    fn stranger(&self) -> Client<TcpStream> {
        let address = self.key["address"].as_str().unwrap();
        let port = u16::try_from(self.key["port"].as_u64().unwrap()).unwrap();
        let write = TcpStream::connect((address, port)).unwrap();
        write
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let read = BufReader::new(write.try_clone().unwrap());
        Client { write, read }
    }

    /// A connection that has given the token.
    fn client(&self) -> Client<TcpStream> {
        let mut client = self.stranger();
        let answer = client.ask(&self.token_line());
        assert_eq!(answer, json!({"version": 3, "ok": true}));
        client
    }

    fn unix_client(&self) -> Client<UnixStream> {
        let write = UnixStream::connect(self.folder.path().join("control.sock")).unwrap();
        let read = BufReader::new(write.try_clone().unwrap());
        Client { write, read }
    }

    /// Waits for ticks that have seen every request made before.
    fn tick_on(&self) {
        let ticks = self.daemon.ticks();
        while self.daemon.ticks() < ticks + 3 {
            std::thread::yield_now();
        }
    }
}

struct Client<S> {
    write: S,
    read: BufReader<S>,
}

impl<S: Read + Write> Client<S> {
    fn ask(&mut self, line: &str) -> Value {
        writeln!(self.write, "{line}").unwrap();
        self.line()
    }

    fn line(&mut self) -> Value {
        let mut line = String::new();
        self.read.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line:?}"))
    }

    /// What comes until the connection is closed.
    fn rest(&mut self) -> String {
        let mut rest = String::new();
        self.read.read_to_string(&mut rest).unwrap();
        rest
    }
}

fn token_file(folder: &Path) -> PathBuf {
    folder.join("control.sock.token")
}

#[test]
fn a_client_with_the_token_is_served_as_on_the_unix_socket() {
    let bench = Bench::start();
    let mut client = bench.client();
    assert_eq!(client.ask(STATUS)["ok"], true);
    let refused = client.ask(r#"{"version":3,"command":"arm","attendance":"hold"}"#);
    let error = refused["error"].as_str().unwrap();
    assert!(error.contains("mode disconnected"), "{error}");
    // A client need not wait for the answer to its token.
    let mut hasty = bench.stranger();
    write!(hasty.write, "{}\n{WATCH}\n", bench.token_line()).unwrap();
    assert_eq!(hasty.line()["ok"], true);
    assert_eq!(hasty.line()["ok"], true);
    assert_eq!(client.ask(STOP)["ok"], true);
    while bench.daemon.snapshot().mode() != Mode::Fault {
        std::thread::yield_now();
    }
    let states = r#"{"version":3,"command":"watch","topics":["state"]}"#;
    assert_eq!(client.ask(states)["ok"], true);
    assert_eq!(client.line()["mode"], "fault");
}

#[test]
fn nothing_is_obeyed_or_answered_without_the_token() {
    let bench = Bench::start();
    let token = bench.key["token"].as_str().unwrap();
    let body = format!("{}\n{STOP}\n", bench.token_line());
    // Of a web page on this computer, which may send any body to any port.
    let posted = format!(
        "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\nContent-Length: {}\r\n\r\n{body}",
        body.len(),
    );
    let wrong = |token: &str| {
        let line = json!({"version": 3, "command": "token", "token": token});
        format!("{line}\n{STOP}\n")
    };
    let cases = [
        format!("{STOP}\n{body}"),
        format!("{STATUS}\n"),
        format!("\n{body}"),
        wrong(""),
        wrong(&token[1..]),
        wrong(&format!("{token}0")),
        posted,
        format!("GET /?{token} HTTP/1.1\r\nUpgrade: websocket\r\n\r\n{body}"),
        // A line that does not end.
        format!("{}{body}", "x".repeat(100_000)),
        "\u{16}\u{3}\u{1}\u{2}\0\n".to_owned(),
    ];
    for cases in cases.chunks(5) {
        let began = Instant::now();
        let strangers: Vec<_> = cases
            .iter()
            .map(|sent| {
                let mut stranger = bench.stranger();
                stranger.write.write_all(sent.as_bytes()).unwrap();
                (sent, stranger)
            })
            .collect();
        for (sent, mut stranger) in strangers {
            let answer = stranger.line();
            assert!(began.elapsed() >= Duration::from_millis(500), "{sent}");
            assert_eq!(answer["ok"], false, "{sent}");
            let error = answer["error"].as_str().unwrap();
            assert!(
                error.contains("the first line must be") && error.contains("control.sock.token"),
                "{error}"
            );
            assert!(!error.contains(token));
            assert_eq!(stranger.rest(), "", "{sent}");
        }
    }
    bench.tick_on();
    assert_eq!(bench.daemon.snapshot().mode(), Mode::Disconnected);
    // The same bytes with the token first do stop it.
    let mut client = bench.stranger();
    client.write.write_all(body.as_bytes()).unwrap();
    while bench.daemon.snapshot().mode() != Mode::Fault {
        std::thread::yield_now();
    }
}

#[test]
fn those_without_the_token_keep_nobody_out_and_are_closed_soon() {
    let bench = Bench::start();
    let mut strangers: Vec<_> = (0..17).map(|_| bench.stranger()).collect();
    // A newer one takes the place of the oldest.
    assert_eq!(strangers.remove(0).rest(), "");
    assert_eq!(bench.client().ask(STATUS)["ok"], true);
    assert_eq!(strangers.remove(0).rest(), "");
    assert_eq!(bench.unix_client().ask(STATUS)["ok"], true);
    for stranger in &mut strangers {
        assert_eq!(stranger.line()["ok"], false);
        assert_eq!(stranger.rest(), "");
    }
    assert_eq!(bench.client().ask(STATUS)["ok"], true);
}

#[test]
fn both_kinds_of_clients_share_their_places_and_a_stop_needs_none() {
    let bench = Bench::start();
    let mut tcp: Vec<_> = (0..16).map(|_| bench.client()).collect();
    let mut unix: Vec<_> = (0..16).map(|_| bench.unix_client()).collect();
    for client in &mut tcp {
        assert_eq!(client.ask(WATCH)["ok"], true);
    }
    for client in &mut unix {
        assert_eq!(client.ask(STATUS)["ok"], true);
    }
    let refused = [bench.client().ask(STATUS), bench.unix_client().ask(STATUS)];
    for refused in refused {
        let error = refused["error"].as_str().unwrap();
        assert!(error.contains("32 clients are connected"), "{error}");
    }
    assert_eq!(bench.client().ask(STOP)["ok"], true);
    while bench.daemon.snapshot().mode() != Mode::Fault {
        std::thread::yield_now();
    }
}

#[test]
fn the_token_is_for_the_group_of_the_socket_and_new_at_every_start() {
    let first = Bench::start();
    let path = token_file(first.folder.path());
    let mode = fs::metadata(&path).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    let second = Bench::start();
    assert_ne!(first.key["token"], second.key["token"]);
    let mut stranger = second.stranger();
    assert_eq!(stranger.ask(&first.token_line())["ok"], false);
    first.daemon.stop().unwrap();
    assert!(!path.exists());
}

#[test]
fn a_port_that_is_taken_is_named_and_nothing_is_left() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path());
    config.socket.tcp_port = Some(port);
    let error = Daemon::start(config, StartOptions::default()).unwrap_err();
    assert!(
        error.contains(&format!("socket.tcp_port is {port}: can't listen"))
            && error.contains("choose another port"),
        "{error}"
    );
    assert!(!token_file(folder.path()).exists());
    assert!(!folder.path().join("control.sock").exists());
}

#[test]
fn a_client_that_only_closes_its_side_is_answered() {
    let bench = Bench::start();
    let mut client = bench.stranger();
    write!(client.write, "{}\n{STATUS}\n", bench.token_line()).unwrap();
    client.write.shutdown(Shutdown::Write).unwrap();
    assert_eq!(client.line()["ok"], true);
    assert!(client.line()["status"]["figures"]["ticks"].is_u64());
    assert_eq!(client.rest(), "");
}

/// The shipped program. Dropping it kills it.
struct Shipped(Child);

impl Drop for Shipped {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Shipped {
    /// Starts it, and waits until it serves its Unix socket.
    fn start(folder: &Path, tcp_port: Option<u16>) -> Self {
        let mut config = config(folder);
        config.socket.tcp_port = tcp_port;
        let file = folder.join("singletrackd.toml");
        fs::write(&file, toml::to_string(&config).unwrap()).unwrap();
        let program = Command::new(env!("CARGO_BIN_EXE_singletrackd"))
            .arg("--config")
            .arg(&file)
            .env_remove("NOTIFY_SOCKET")
            .spawn()
            .unwrap();
        let program = Self(program);
        let mut client = loop {
            match UnixStream::connect(folder.join("control.sock")) {
                Ok(client) => break client,
                Err(_) => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        writeln!(client, "{STATUS}").unwrap();
        let mut answer = String::new();
        BufReader::new(client).read_line(&mut answer).unwrap();
        assert!(answer.contains("\"ok\":true"), "{answer}");
        program
    }

    /// The addresses on which the process listens.
    fn listens_on(&self) -> Vec<SocketAddr> {
        let process = format!("/proc/{}", self.0.id());
        let inodes: HashSet<String> = fs::read_dir(format!("{process}/fd"))
            .unwrap()
            .filter_map(|entry| {
                let target = fs::read_link(entry.ok()?.path()).ok()?;
                let inode = target.to_str()?.strip_prefix("socket:[")?;
                Some(inode.strip_suffix(']')?.to_owned())
            })
            .collect();
        assert!(!inodes.is_empty());
        // sl local_address rem_address st queues tr tm->when retrnsmt uid timeout inode
        let of_table = |table: &str| -> Vec<SocketAddr> {
            let text = fs::read_to_string(format!("{process}/net/{table}")).unwrap();
            let lines = text.lines().skip(1).filter_map(|line| {
                let words: Vec<_> = line.split_whitespace().collect();
                let (ip, port) = words[1].split_once(':').unwrap();
                let is_listening = words[3] == "0A" && inodes.contains(words[9]);
                let port = u16::from_str_radix(port, 16).unwrap();
                let ip = u32::from_str_radix(ip, 16).unwrap_or(0).to_ne_bytes();
                is_listening.then(|| SocketAddr::from((ip, port)))
            });
            lines.collect()
        };
        [of_table("tcp"), of_table("tcp6")].concat()
    }
}

#[test]
fn nothing_listens_on_tcp_unless_it_is_configured_and_then_on_loopback_alone() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Shipped::start(folder.path(), None);
    assert_eq!(daemon.listens_on(), []);
    assert!(!token_file(folder.path()).exists());
    drop(daemon);
    let daemon = Shipped::start(folder.path(), Some(0));
    let key: Value = serde_json::from_slice(&fs::read(token_file(folder.path())).unwrap()).unwrap();
    let port = u16::try_from(key["port"].as_u64().unwrap()).unwrap();
    assert_eq!(
        daemon.listens_on(),
        [SocketAddr::from((Ipv4Addr::LOCALHOST, port))]
    );
}
