//! The shipped binary under a service manager: its notifications, and their times.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    ffi::CString,
    fs,
    io::{BufRead, BufReader, Write},
    os::{
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            net::{SocketAddr, UnixDatagram, UnixStream},
            process::CommandExt,
        },
    },
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use singletrackd::monotonic_ns;
use tempfile::TempDir;

use crate::common::wait_for;
use crate::terminal::Terminal;

/// The longest time between two signs of life.
const WATCHDOG: Duration = Duration::from_millis(400);

/// A service manager with one service.
struct Manager {
    socket: UnixDatagram,
    daemon: Child,
    folder: TempDir,
}

impl Manager {
    /// A manager that listens on `address`, made from a folder's path.
    fn start(address: impl FnOnce(&Path) -> (SocketAddr, String)) -> Self {
        Self::start_with(address, |_| {})
    }

    /// With a command that `prepare` changes before it starts the daemon.
    fn start_with(
        address: impl FnOnce(&Path) -> (SocketAddr, String),
        prepare: impl FnOnce(&mut Command),
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (address, name) = address(folder.path());
        let socket = UnixDatagram::bind_addr(&address).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let config = folder.path().join("singletrackd.toml");
        fs::write(&config, configuration(folder.path())).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_singletrackd"));
        command
            .arg("--config")
            .arg(&config)
            .env("NOTIFY_SOCKET", name)
            .env("WATCHDOG_USEC", WATCHDOG.as_micros().to_string())
            .env_remove("WATCHDOG_PID")
            .stderr(Stdio::null());
        prepare(&mut command);
        Self {
            socket,
            daemon: command.spawn().unwrap(),
            folder,
        }
    }

    /// A manager with a path for its address.
    fn by_path() -> Self {
        Self::start(path)
    }

    /// The next datagram.
    fn receive(&self) -> String {
        let mut buffer = [0; 4_096];
        let length = self.socket.recv(&mut buffer).unwrap();
        String::from_utf8(buffer[..length].to_vec()).unwrap()
    }

    /// Waits for a notification that begins with `start`.
    fn wait_for(&self, start: &str) -> String {
        loop {
            let text = self.receive();
            if text.starts_with(start) {
                return text;
            }
        }
    }

    /// The number of signs of life in `time`.
    fn signs_of_life(&self, time: Duration) -> usize {
        let begin = Instant::now();
        let mut count = 0;
        let mut buffer = [0; 4_096];
        while let Some(rest) = time.checked_sub(begin.elapsed())
            && !rest.is_zero()
        {
            self.socket.set_read_timeout(Some(rest)).unwrap();
            if let Ok(length) = self.socket.recv(&mut buffer) {
                count += usize::from(&buffer[..length] == b"WATCHDOG=1");
            }
        }
        self.socket
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        count
    }

    /// Replaces the configuration and reloads it. Returns both notifications.
    fn reload(&self, configuration: &str) -> (String, String) {
        fs::write(self.folder.path().join("singletrackd.toml"), configuration).unwrap();
        self.signal(libc::SIGHUP);
        (self.wait_for("RELOADING=1"), self.wait_for("READY=1"))
    }

    /// The state of the configuration, from the control socket.
    fn configuration(&self) -> serde_json::Value {
        self.status()["configuration"].clone()
    }

    /// The status, from the control socket.
    fn status(&self) -> serde_json::Value {
        let mut stream = UnixStream::connect(self.folder.path().join("control.sock")).unwrap();
        writeln!(stream, r#"{{"version":3,"command":"status"}}"#).unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        let answer: serde_json::Value = serde_json::from_str(&line).unwrap();
        answer["status"].clone()
    }

    fn signal(&self, signal: libc::c_int) {
        let process = libc::pid_t::try_from(self.daemon.id()).unwrap();
        // SAFETY: our own child, which has not been waited for.
        assert_eq!(unsafe { libc::kill(process, signal) }, 0);
    }

    fn thread(&self, name: &str) -> libc::pid_t {
        let tasks = PathBuf::from(format!("/proc/{}/task", self.daemon.id()));
        fs::read_dir(tasks)
            .unwrap()
            .map(|task| task.unwrap())
            .find(|task| {
                fs::read_to_string(task.path().join("comm"))
                    .unwrap_or_default()
                    .trim()
                    == name
            })
            .unwrap()
            .file_name()
            .to_str()
            .unwrap()
            .parse()
            .unwrap()
    }
}

impl Drop for Manager {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
    }
}

/// An address in a folder, and its name for the daemon.
fn path(folder: &Path) -> (SocketAddr, String) {
    let path = folder.join("notify");
    (
        SocketAddr::from_pathname(&path).unwrap(),
        path.to_str().unwrap().to_owned(),
    )
}

/// The configuration of a daemon without board and cameras.
fn configuration(folder: &Path) -> String {
    let example = include_str!("../singletrackd.example.toml");
    let path = |name: &str| folder.join(name).display().to_string();
    let mut table: toml::Table = toml::from_str(example).unwrap();
    let mut set = |section: &str, key: &str, value: toml::Value| {
        table[section]
            .as_table_mut()
            .unwrap()
            .insert(key.to_owned(), value);
    };
    set("serial", "port", path("board").into());
    set("motion_capture", "server", "127.0.0.1".into());
    set("motion_capture", "command_port", 9.into());
    set("control", "realtime_priority", 0.into());
    set("record", "directory", path("records").into());
    set("socket", "path", path("control.sock").into());
    let state: toml::Table = [("directory".to_owned(), path("state").into())]
        .into_iter()
        .collect();
    table.insert("state".to_owned(), state.into());
    toml::to_string(&table).unwrap()
}

#[test]
fn it_is_ready_when_the_controller_ticks_and_sends_its_status() {
    let manager = Manager::by_path();
    let first = manager.receive();
    assert!(
        first.starts_with("READY=1\nSTATUS=mode disconnected"),
        "{first}"
    );
    assert_eq!(manager.wait_for("WATCHDOG"), "WATCHDOG=1");
}

#[test]
fn a_manager_with_an_abstract_name_is_notified() {
    let manager = Manager::start(|folder| {
        let name = folder.display().to_string();
        (
            SocketAddr::from_abstract_name(&name).unwrap(),
            format!("@{name}"),
        )
    });
    assert!(manager.receive().starts_with("READY=1\n"));
}

#[test]
fn signs_of_life_come_only_while_the_control_thread_lives() {
    let manager = Manager::by_path();
    manager.wait_for("READY=1");
    let alive = manager.signs_of_life(5 * WATCHDOG);
    assert!((5..=11).contains(&alive), "{alive} in five intervals");

    let control = manager.thread("control");
    let frozen = Frozen::new(control);
    // One may be on its way, and the ticks since the last one allow one more.
    assert!(manager.signs_of_life(WATCHDOG) <= 2);
    assert_eq!(manager.signs_of_life(3 * WATCHDOG), 0);

    drop(frozen);
    assert_eq!(manager.wait_for("WATCHDOG"), "WATCHDOG=1");
}

#[test]
fn the_control_thread_causes_no_page_fault() {
    let manager = Manager::by_path();
    manager.wait_for("READY=1");
    let control = manager.thread("control");
    let status = format!("/proc/{}/task/{control}/stat", manager.daemon.id());
    // minflt and majflt, counted from the field after the name.
    let faults = || -> u64 {
        let text = fs::read_to_string(&status).unwrap();
        let (_, numbers) = text.rsplit_once(") ").unwrap();
        let number = |place| -> u64 { numbers.split(' ').nth(place).unwrap().parse().unwrap() };
        number(7) + number(9)
    };
    // The pages of the code are loaded once it has run.
    manager.signs_of_life(WATCHDOG);
    let before = faults();
    assert!(before > 0);
    // About three hundred ticks: every ring wraps around.
    manager.signs_of_life(Duration::from_secs(3));
    assert_eq!(faults(), before);
}

#[test]
fn a_full_disk_ends_the_record_and_not_the_daemon_and_is_reported() {
    // The limit of a file's length has the same effect as a full disk.
    const LONGEST: libc::rlim_t = 40_000;
    let mut manager = Manager::start_with(path, |command| {
        let limit = || {
            let limit = libc::rlimit {
                rlim_cur: LONGEST,
                rlim_max: LONGEST,
            };
            // SAFETY: both calls are allowed between fork and exec, and the limit
            // outlives its call.
            unsafe {
                libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
                libc::setrlimit(libc::RLIMIT_FSIZE, &raw const limit);
            }
            Ok(())
        };
        // SAFETY: see the calls.
        unsafe { command.pre_exec(limit) };
    });
    manager.wait_for("READY=1");
    let mut status = String::new();
    while !status.contains("nothing is recorded") {
        status = manager.wait_for("STATUS=");
    }
    assert!(
        status.contains(".mcap") && status.contains("File too large"),
        "{status}"
    );
    // The daemon goes on; its exit status reports the failure.
    manager.wait_for("WATCHDOG=1");
    manager.signal(libc::SIGTERM);
    let mut exit = None;
    wait_for("the end", || {
        exit = manager.daemon.try_wait().unwrap();
        exit.is_some()
    });
    assert_eq!(exit.unwrap().code(), Some(1));
}

#[test]
fn a_reloaded_configuration_comes_into_force() {
    let manager = Manager::by_path();
    manager.wait_for("READY=1");
    let before_us = monotonic_ns() / 1_000;
    let changed = configuration(manager.folder.path()).replace("radius_m = 0.85", "radius_m = 0.9");
    let (reloading, ready) = manager.reload(&changed);
    let time_us: u64 = reloading
        .strip_prefix("RELOADING=1\nMONOTONIC_USEC=")
        .unwrap()
        .parse()
        .unwrap();
    assert!((before_us..=monotonic_ns() / 1_000).contains(&time_us));
    assert!(ready.contains("; configuration 2"), "{ready}");
    assert_eq!(manager.configuration()["number"], 2);
}

#[test]
fn a_refused_configuration_changes_nothing_and_the_reason_is_in_the_status() {
    let manager = Manager::by_path();
    manager.wait_for("READY=1");
    let good = configuration(manager.folder.path());
    for (changed, why) in [
        (good.replace("radius_m = 0.85", "radius_m = -1.0"), "radius"),
        (
            good.replace("[reference]", "[reference"),
            "singletrackd.toml",
        ),
        (
            good.replace(
                "realtime_priority = 0",
                "realtime_priority = 0\nperiod_ms = 20",
            ),
            "control.period_ms can't change while singletrackd runs: restart it",
        ),
        (
            good.replace("/board\"", "/another-board\""),
            "serial.port can't change",
        ),
    ] {
        assert_ne!(changed, good);
        let (_, ready) = manager.reload(&changed);
        assert!(ready.contains("reload refused:"), "{ready}");
        assert!(ready.contains(why), "{why}: {ready}");
        let configuration = manager.configuration();
        assert_eq!(configuration["number"], 1);
        assert_eq!(configuration["last_change"]["by"], "reload");
        let error = configuration["last_change"]["error"].as_str().unwrap();
        assert!(error.contains(why), "{why}: {error}");
    }
    let (_, ready) = manager.reload(&good);
    assert!(ready.ends_with("; configuration 2"), "{ready}");
}

#[test]
fn a_configuration_that_is_not_a_regular_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let fifo = folder.path().join("singletrackd.toml");
    let made = Command::new("mkfifo").arg(&fifo).status().unwrap();
    assert!(made.success());
    let output = Command::new(env!("CARGO_BIN_EXE_singletrackd"))
        .arg("--config")
        .arg(&fifo)
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        error.contains("a pipe, a socket or a device; name a file"),
        "{error}"
    );
}

#[test]
fn sighup_ends_the_daemon_only_after_its_terminal_was_closed() {
    let terminal = Terminal::open();
    let device = CString::new(terminal.device().as_os_str().as_bytes()).unwrap();
    let manager = Manager::start_with(path, |command| {
        // The first terminal that a session leader opens becomes the session's.
        let take_terminal = move || {
            // SAFETY: both calls are allowed between fork and exec, and the name
            // outlives its call.
            let opened = unsafe {
                libc::setsid();
                libc::open(device.as_ptr(), libc::O_RDWR)
            };
            if opened == -1 {
                return Err(std::io::Error::last_os_error());
            }
            Ok(())
        };
        // SAFETY: see the calls.
        unsafe { command.pre_exec(take_terminal) };
    });
    manager.wait_for("READY=1");
    manager.signal(libc::SIGHUP);
    manager.wait_for("RELOADING=1");
    // The kernel sends the signal.
    drop(terminal);
    let text = manager.wait_for("STOPPING=1");
    assert!(text.contains("SIGHUP"), "{text}");
}

#[test]
fn the_manager_is_notified_of_the_shutdown() {
    let mut manager = Manager::by_path();
    manager.wait_for("READY=1");
    manager.signal(libc::SIGTERM);
    let text = manager.wait_for("STOPPING=1");
    assert!(text.contains("\nSTATUS=SIGTERM"), "{text}");
    let mut status = None;
    wait_for("the end", || {
        status = manager.daemon.try_wait().unwrap();
        status.is_some()
    });
    assert!(status.unwrap().success());
}

#[test]
fn it_runs_without_a_manager_and_with_one_of_an_unknown_kind() {
    for name in ["", "vsock:2:1234"] {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("singletrackd.toml");
        fs::write(&config, configuration(folder.path())).unwrap();
        let daemon = Command::new(env!("CARGO_BIN_EXE_singletrackd"))
            .arg("--config")
            .arg(&config)
            .env("NOTIFY_SOCKET", name)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let socket = folder.path().join("control.sock");
        wait_for("a socket", || socket.exists());
        // SAFETY: our own child, which has not been waited for.
        unsafe { libc::kill(libc::pid_t::try_from(daemon.id()).unwrap(), libc::SIGTERM) };
        let output = daemon.wait_with_output().unwrap();
        let log = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{log}");
        assert_eq!(log.contains("NOTIFY_SOCKET"), !name.is_empty(), "{log}");
    }
}

/// A thread of another process that is stopped until this value is dropped.
struct Frozen(libc::pid_t);

impl Frozen {
    fn new(thread: libc::pid_t) -> Self {
        trace(libc::PTRACE_SEIZE, thread);
        trace(libc::PTRACE_INTERRUPT, thread);
        let mut status = 0;
        // SAFETY: the status outlives the call.
        let stopped = unsafe { libc::waitpid(thread, &raw mut status, libc::__WALL) };
        assert_eq!(stopped, thread);
        assert!(libc::WIFSTOPPED(status));
        Self(thread)
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        trace(libc::PTRACE_DETACH, self.0);
    }
}

fn trace(request: libc::c_uint, thread: libc::pid_t) {
    let nothing = core::ptr::null_mut::<libc::c_void>();
    // SAFETY: these requests take a thread of our own child and no pointer.
    let result = unsafe { libc::ptrace(request, thread, nothing, nothing) };
    assert_eq!(result, 0, "{}", std::io::Error::last_os_error());
}
