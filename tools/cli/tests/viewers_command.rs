//! `singletrack page` and `singletrack live` as processes.

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{SocketAddr, TcpStream},
    os::unix::fs::PermissionsExt as _,
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    time::Duration,
};

use rustix::process::{Pid, Signal, kill_process};
use singletrack_core::Config;
use singletrackd::{Daemon, StartOptions};

use crate::daemon::{config, wait_for};

/// A command that serves.
struct Server {
    child: Child,
    /// What it printed first.
    line: String,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Server {
    fn start(command: &mut Command) -> Self {
        command
            .env_remove("SINGLETRACK_SOCKET")
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        let output = child.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut line).unwrap();
        Self { child, line }
    }

    /// The address that it printed.
    fn address(&self) -> SocketAddr {
        let (_, address) = self.line.trim_end().split_once("://").unwrap();
        address.split('/').next().unwrap().parse().unwrap()
    }

    /// Ends it as systemd does.
    fn terminate(&mut self) -> ExitStatus {
        kill_process(Pid::from_child(&self.child), Signal::TERM).unwrap();
        self.child.wait().unwrap()
    }

    /// The most memory that it has had, in bytes.
    fn peak_memory(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.unwrap().split_whitespace().next().unwrap();
        1_024 * kilobytes.parse::<u64>().unwrap()
    }
}

fn singletrack(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.args(arguments);
    command
}

fn request(address: SocketAddr, path: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    stream
}

fn answer(mut stream: TcpStream) -> String {
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// A configuration file with these sections for the daemon of a folder.
fn write_config(folder: &Path, change: impl FnOnce(&mut Config)) -> Config {
    let mut config = config(folder);
    config.record.enabled = false;
    change(&mut config);
    fs::write(folder.join("daemon.toml"), config.to_toml().unwrap()).unwrap();
    config
}

#[test]
fn address_token_and_socket_come_from_the_daemons_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let token_file = folder.path().join("token");
    let config = write_config(folder.path(), |config| {
        // Not enabled: the command serves in either case.
        config.page.port = 0;
        config.page.token_file = Some(token_file.clone());
        config.live.port = 0;
    });
    let _daemon = Daemon::start(config, StartOptions::default()).unwrap();
    let file = folder.path().join("daemon.toml");
    let file = file.to_str().unwrap();
    let mut page = Server::start(&mut singletrack(&["page", "--config", file]));
    assert!(
        page.line.starts_with("Page: http://127.0.0.1:"),
        "{}",
        page.line
    );
    assert!(
        page.line.contains(token_file.to_str().unwrap()),
        "{}",
        page.line
    );
    let mode = fs::metadata(&token_file).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    let key = fs::read_to_string(&token_file).unwrap();
    let key: serde_json::Value = serde_json::from_str(&key).unwrap();
    let path = format!("/setup.json?token={}", key["token"].as_str().unwrap());
    let setup = answer(request(page.address(), &path));
    assert!(setup.starts_with("HTTP/1.1 200 "), "{setup}");
    let mut live = Server::start(&mut singletrack(&["live", "--config", file]));
    assert!(
        live.line.starts_with("Live view: ws://127.0.0.1:"),
        "{}",
        live.line
    );
    // Options win.
    let other = singletrack(&["page", "--config", file, "--address", "127.0.0.2"])
        .arg("--token-file")
        .arg(folder.path().join("other"))
        .stdout(Stdio::piped())
        .spawn()
        .map(|child| Server {
            child,
            line: String::new(),
        });
    wait_for("the token of the other page", || {
        folder.path().join("other").exists()
    });
    drop(other);
    for server in [&mut page, &mut live] {
        let status = server.terminate();
        assert_eq!(status.code(), Some(0));
    }
    assert!(!token_file.exists());
}

#[test]
fn a_page_that_everyone_could_see_is_refused() {
    let output = singletrack(&["page", "--address", "0.0.0.0", "--port", "0"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("page.token_file"), "{said}");
}

#[test]
fn ninety_six_requests_at_once_cost_the_page_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let config = write_config(folder.path(), |_| {});
    let _daemon = Daemon::start(config.clone(), StartOptions::default()).unwrap();
    let mut page = singletrack(&["page", "--port", "0", "--socket"]);
    let page = Server::start(page.arg(&config.socket.path));
    answer(request(page.address(), "/setup.json"));
    let before = page.peak_memory();
    for _ in 0..3 {
        let asking: Vec<_> = (0..96)
            .map(|_| request(page.address(), "/setup.json"))
            .collect();
        for stream in asking {
            assert!(answer(stream).starts_with("HTTP/1.1 200 "));
        }
    }
    // Besides, connections that leave it at that.
    let leaked: Vec<_> = (0..500)
        .map(|_| TcpStream::connect(page.address()).unwrap())
        .collect();
    assert!(answer(request(page.address(), "/")).starts_with("HTTP/1.1 200 "));
    drop(leaked);
    let grown = page.peak_memory() - before;
    assert!(grown < 8 << 20, "{grown} bytes");
}
