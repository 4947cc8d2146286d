//! `singletrack arm` against the daemon and a simulated car in real time, and against a socket
//! that answers as told. What happened when is read from the record.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    io::{BufRead, BufReader, Write},
    net::Ipv4Addr,
    os::unix::net::UnixListener,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};
use singletrack_core::config::{Config, FenceSection};
use singletrack_pilot::{Event, Mode, PilotRequest, Reason};
use singletrack_record::{Entry, Reader, TickRecord, Topic};
use singletrack_sim::{RealTimeConfig, RealTimeSimulator, SimulationConfig, StartPose, UdpConfig};
use singletrackd::{Daemon, StartOptions, monotonic_ns};
use tempfile::TempDir;

/// A drive needs the machine's real time for itself.
static REAL_TIME: Mutex<()> = Mutex::new(());

/// From the end of the operator's program to the first tick of the stop: the daemon's socket
/// thread and a tick; the rest is for a busy machine.
const LET_GO: Duration = Duration::from_millis(150);

/// From the last renewal of a program that hangs to the first tick of the stop: 0.5 s, a
/// renewal period, and as above.
const HANGS: Duration = Duration::from_millis(750);

/// The longest a test waits for something that must happen.
const PATIENCE: Duration = Duration::from_secs(20);

/// Runs a test that needs real time; up to three times, because other work on the machine may
/// have ended the simulated link.
fn on_a_calm_machine(test: impl Fn() + std::panic::UnwindSafe + std::panic::RefUnwindSafe) {
    let _alone = REAL_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    for _ in 0..2 {
        if std::panic::catch_unwind(&test).is_ok() {
            return;
        }
    }
    test();
}

struct Scene {
    daemon: Daemon,
    simulator: RealTimeSimulator,
    socket: PathBuf,
    _folder: TempDir,
}

impl Scene {
    /// A simulated car and its daemon, ready to be armed.
    fn ready() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut simulation = SimulationConfig::default();
        // P is at the start of the example's circle.
        simulation.car.start = StartPose {
            x_m: 0.67,
            y_m: -0.45,
            yaw_rad: 1.2,
        };
        let simulator = RealTimeSimulator::start(RealTimeConfig {
            simulation,
            pty_link: Some(folder.path().join("board")),
            udp: UdpConfig {
                interface: Ipv4Addr::LOCALHOST,
                command_port: 0,
                data_port: 0,
            },
            ..RealTimeConfig::default()
        })
        .unwrap();
        let example = include_str!("../../../host/daemon/singletrackd.example.toml");
        let mut config = Config::from_toml(example).unwrap();
        config.serial.port = simulator.pty_path().to_owned();
        config.motion_capture.server = Ipv4Addr::LOCALHOST;
        config.motion_capture.command_port = simulator.command_address().port();
        config.motion_capture.data_port = simulator.data_address().port();
        // As a car that has driven before, on a wide floor.
        config.supervisor.prove_first_metre = false;
        config.fence = FenceSection::square(6.0, 1.4);
        // A busy machine is not the subject.
        config.watch.max_gap_ms = 80;
        config.record.directory = folder.path().join("records");
        config.state.directory = folder.path().join("state");
        config.socket.path = folder.path().join("control.sock");
        let socket = config.socket.path.clone();
        let daemon = Daemon::start(config, StartOptions::default()).unwrap();
        let scene = Self {
            daemon,
            simulator,
            socket,
            _folder: folder,
        };
        scene.wait_for(Mode::Ready);
        scene
    }

    #[track_caller]
    fn wait_for(&self, mode: Mode) {
        let begin = Instant::now();
        while self.daemon.snapshot().mode() != mode {
            let snapshot = self.daemon.snapshot();
            assert!(
                begin.elapsed() < PATIENCE,
                "{mode} does not come: {} {:?}",
                snapshot.mode(),
                snapshot.reason()
            );
            thread::sleep(Duration::from_millis(2));
        }
    }

    fn arm(&self, options: &[&str]) -> Child {
        Command::new(env!("CARGO_BIN_EXE_singletrack"))
            .arg("arm")
            .args(options)
            .arg("--socket")
            .arg(&self.socket)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Waits until the car has driven for a second.
    fn drive(&self) {
        self.wait_for(Mode::Driving);
        thread::sleep(Duration::from_secs(1));
        assert_eq!(self.daemon.snapshot().mode(), Mode::Driving);
    }

    /// Ends the daemon; the ticks of its record.
    fn ticks(self) -> Vec<TickRecord> {
        let record = self.daemon.stop().unwrap().record.unwrap();
        self.simulator.stop().unwrap();
        Reader::open(&record)
            .unwrap()
            .only(&[Topic::Tick])
            .map(|entry| match entry.unwrap() {
                Entry::Tick(tick) => tick,
                other => panic!("{other:?}"),
            })
            .collect()
    }
}

/// The first tick of the stop, and the first at which the car stands again.
fn stop_of(ticks: &[TickRecord]) -> (&TickRecord, &TickRecord) {
    let after = ticks
        .iter()
        .skip_while(|tick| tick.output.mode != Mode::Driving)
        .skip_while(|tick| tick.output.mode == Mode::Driving);
    let mut after = after.peekable();
    let first = *after.peek().unwrap();
    let stands = after
        .find(|tick| matches!(tick.output.mode, Mode::Idle | Mode::Ready))
        .unwrap();
    (first, stands)
}

fn signal(child: &Child, signal: Signal) {
    let pid = Pid::from_raw(child.id().try_into().unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_killed_operator_stops_the_car_at_once() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let mut operator = scene.arm(&[]);
        scene.drive();
        let killed_ns = monotonic_ns();
        operator.kill().unwrap();
        operator.wait().unwrap();
        scene.wait_for(Mode::Ready);
        let ticks = scene.ticks();
        let (first, stands) = stop_of(&ticks);
        assert_eq!(first.output.mode, Mode::Stopping);
        assert_eq!(first.output.reason, Some(Reason::OperatorGone));
        let late = Duration::from_nanos(first.start_ns.saturating_sub(killed_ns));
        println!(
            "the stop begins {late:?} after the kill, and the car stands {:?} later",
            Duration::from_nanos(stands.start_ns - first.start_ns)
        );
        assert!(late < LET_GO, "{late:?}");
    });
}

#[test]
fn an_operator_that_hangs_stops_the_car_within_the_time_of_the_dead_man_switch() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let mut operator = scene.arm(&["--hold"]);
        scene.drive();
        let stopped_ns = monotonic_ns();
        // As with Ctrl-Z, or a terminal that blocks the program's output.
        signal(&operator, Signal::STOP);
        scene.wait_for(Mode::Ready);
        operator.kill().unwrap();
        operator.wait().unwrap();
        let ticks = scene.ticks();
        let (first, _) = stop_of(&ticks);
        assert_eq!(first.output.reason, Some(Reason::OperatorGone));
        let late = Duration::from_nanos(first.start_ns.saturating_sub(stopped_ns));
        println!("the stop begins {late:?} after the operator's program stopped");
        assert!(late < HANGS, "{late:?}");
    });
}

#[test]
fn ctrl_c_disarms_waits_for_standstill_and_is_success() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let operator = scene.arm(&[]);
        scene.drive();
        signal(&operator, Signal::INT);
        let output = operator.wait_with_output().unwrap();
        let ended_ns = monotonic_ns();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        assert!(
            text(&output).contains("the drive has ended after")
                && text(&output).contains("requested"),
            "{output:?}"
        );
        // Not a terminal: no progress.
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        let ticks = scene.ticks();
        let (first, stands) = stop_of(&ticks);
        assert_eq!(first.output.reason, Some(Reason::Requested));
        assert!(stands.start_ns < ended_ns, "it waited for standstill");
    });
}

#[test]
fn a_timed_drive_ends_after_its_time_also_without_its_client() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let mut operator = scene.arm(&["--for", "1500ms"]);
        scene.wait_for(Mode::Driving);
        thread::sleep(Duration::from_millis(300));
        operator.kill().unwrap();
        operator.wait().unwrap();
        scene.wait_for(Mode::Ready);
        let ticks = scene.ticks();
        let (first, _) = stop_of(&ticks);
        assert_eq!(first.output.reason, Some(Reason::TimeUp));
        let driving = ticks
            .iter()
            .find(|tick| tick.output.mode == Mode::Driving)
            .unwrap();
        let driven = Duration::from_nanos(first.start_ns - driving.start_ns);
        println!("driven for {driven:?}");
        // The task renews and looks every 0.1 s.
        let (least, most) = (Duration::from_millis(1_450), Duration::from_millis(1_900));
        assert!((least..most).contains(&driven), "{driven:?}");
    });
}

#[test]
fn an_unattended_drive_goes_on_without_its_client_which_says_so() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let output = scene.arm(&["--unattended"]).wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        assert!(text(&output).contains("driving unattended: the car drives on"));
        thread::sleep(Duration::from_secs(1));
        assert_eq!(scene.daemon.snapshot().mode(), Mode::Driving);
        scene.daemon.request(PilotRequest::Disarm).unwrap();
        scene.wait_for(Mode::Ready);
        let ticks = scene.ticks();
        let holds = ticks
            .iter()
            .flat_map(|tick| &tick.events)
            .filter(|event| matches!(event, Event::Request(PilotRequest::Hold)))
            .count();
        assert_eq!(holds, 0);
    });
}

#[test]
fn a_client_of_an_ended_drive_does_not_end_the_next_one() {
    on_a_calm_machine(|| {
        let scene = Scene::ready();
        let mut first = scene.arm(&["--for", "1000s"]);
        scene.drive();
        scene.daemon.request(PilotRequest::Disarm).unwrap();
        scene.wait_for(Mode::Ready);
        let mut second = scene.arm(&[]);
        scene.wait_for(Mode::Driving);
        let _ = first.kill();
        first.wait().unwrap();
        thread::sleep(Duration::from_millis(700));
        assert_eq!(scene.daemon.snapshot().mode(), Mode::Driving);
        second.kill().unwrap();
        second.wait().unwrap();
        scene.wait_for(Mode::Ready);
        scene.ticks();
    });
}

/// Runs the command against a daemon that answers the first line with `answers`, and then waits
/// for the end of the connection; returns the output, and what the daemon was sent.
fn scripted(options: &[&str], answers: &'static [&str]) -> (Output, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        let mut asked = vec![lines.next().unwrap().unwrap()];
        for answer in answers {
            writeln!(stream, "{answer}").unwrap();
            thread::sleep(Duration::from_millis(250));
        }
        // What the client has sent by now is still read.
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        asked.extend(lines.map_while(Result::ok));
        asked
    });
    let output = run(options, &path);
    (output, daemon.join().unwrap())
}

fn run(options: &[&str], socket: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("arm")
        .args(options)
        .arg("--socket")
        .arg(socket)
        .output()
        .unwrap()
}

#[test]
fn a_held_drive_is_renewed_and_the_exit_status_tells_how_it_ended() {
    for (ended, status) in [
        (
            r#"{"version":2,"ended":{"mode":"idle","reason":"requested"}}"#,
            0,
        ),
        (
            r#"{"version":2,"ended":{"mode":"ready","reason":"reference-finished"}}"#,
            0,
        ),
        (
            r#"{"version":2,"ended":{"mode":"idle","reason":"outside-fence"}}"#,
            3,
        ),
        (
            r#"{"version":2,"ended":{"mode":"fault","reason":"stop-not-obeyed"}}"#,
            3,
        ),
        (
            r#"{"version":2,"ok":false,"error":"can't arm: mode idle: no-pose"}"#,
            1,
        ),
    ] {
        let answers: &'static [&str] = Box::leak(Box::new([
            r#"{"version":2,"ok":true}"#,
            r#"{"version":2,"drive":{"mode":"driving","reason":null,"drive_time_s":0.2}}"#,
            ended,
        ]));
        let (output, asked) = scripted(&[], answers);
        assert_eq!(output.status.code(), Some(status), "{ended} {output:?}");
        assert_eq!(
            serde_json::from_str::<serde_json::Value>(&asked[0]).unwrap(),
            serde_json::json!({"version": 2, "command": "arm", "attendance": "hold"})
        );
        // Every 0.1 s, over half a second.
        let holds = asked
            .iter()
            .filter(|line| line.contains(r#""command":"hold""#))
            .count();
        assert!(holds >= 2, "{asked:?}");
    }
}

#[test]
fn a_lost_connection_is_an_error() {
    let (output, _) = scripted(&[], &[r#"{"version":2,"ok":true}"#]);
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(error.contains("lost the connection"), "{error}");
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    for options in [
        &["--hold", "--unattended"][..],
        &["--for", "60s", "--unattended"],
        &["--for", "60s", "--hold"],
        &["--for", "0s"],
        &["--for", "soon"],
    ] {
        assert_eq!(run(options, Path::new("/nowhere")).status.code(), Some(2));
    }
}
