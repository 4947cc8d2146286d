//! `singletrack fleet` with two daemons and two simulated cars on one floor, in real time.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::{
    fmt::Write as _,
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use singletrack_core::config::{ReferenceSection, Start};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_fleet::{FleetCar, fleet_floor, fleet_simulation},
};
use singletrack_sim::{RealTimeConfig, RealTimeSimulator, SharedFloor, StartPose, UdpConfig};
use singletrackd::{Daemon, StartOptions};

/// Longer than a car takes to be ready, to drive or to stop.
const PATIENCE: Duration = Duration::from_secs(20);

fn car(index: usize) -> FleetCar {
    let names = ["car1", "car2"];
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: 0.5,
        centre_m: [4.0 * index as f64, 0.0],
        start: Start::Nearest,
    }));
    config.motion_capture.rigid_body = names[index].to_owned();
    config.safety_filter.enabled = true;
    config.neighbours.enabled = true;
    config.neighbours.expected = vec![names[1 - index].to_owned()];
    FleetCar {
        config,
        start: StartPose {
            x_m: 4.0 * index as f64 + 1.0,
            y_m: 0.0,
            yaw_rad: core::f64::consts::FRAC_PI_2,
        },
        seed: index as u64,
    }
}

/// Starts simulators and daemons. `relay` is told where the cameras of the first one are, and says
/// where the daemons find them.
fn start(
    folder: &Path,
    cars: &[FleetCar; 2],
    relay: Option<&mut dyn FnMut(u16) -> u16>,
) -> Vec<(RealTimeSimulator, Daemon)> {
    let mut relay = relay;
    let mut relayed = None;
    let floor = Arc::new(Mutex::new(fleet_floor(cars)));
    let mut fleet = String::new();
    let mut start = |index: usize| {
        let mut config = cars[index].config.clone();
        let folder = folder.join(&config.motion_capture.rigid_body);
        std::fs::create_dir(&folder).unwrap();
        let simulated = RealTimeConfig {
            simulation: fleet_simulation(cars, index),
            pty_link: Some(folder.join("board")),
            udp: UdpConfig {
                command_port: 0,
                data_port: 0,
                ..UdpConfig::default()
            },
            floor: Some(SharedFloor {
                floor: Arc::clone(&floor),
                index,
            }),
            ..RealTimeConfig::default()
        };
        // It stands for hardware, which shares no processor: where that is permitted, its threads
        // are scheduled in real time.
        let simulator = thread::spawn(|| {
            let _ = singletrackd::realtime::make_punctual(1);
            RealTimeSimulator::start(simulated).unwrap()
        })
        .join()
        .unwrap();
        config.serial.port = simulator.pty_path.to_owned();
        let mut cameras = simulator.command_address.port();
        if let Some(relay) = &mut relay {
            cameras = *relayed.get_or_insert_with(|| relay(cameras));
        }
        config.motion_capture.command_port = Some(cameras);
        config.motion_capture.data_port = simulator.data_address.port();
        config.state.directory = folder.join("state");
        config.record.enabled = false;
        config.socket.path = folder.join("control.sock");
        let (name, socket) = (&config.motion_capture.rigid_body, &config.socket.path);
        writeln!(fleet, "[[car]]\nname = \"{name}\"\nsocket = {socket:?}").unwrap();
        let daemon = Daemon::start(config, StartOptions::default()).unwrap();
        (simulator, daemon)
    };
    let started = vec![start(0), start(1)];
    std::fs::write(folder.join("fleet.toml"), fleet).unwrap();
    started
}

fn fleet(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.arg("fleet").args(arguments);
    command.arg("--fleet").arg(folder.join("fleet.toml"));
    command
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    format!("{out}{err}")
}

fn wait(fleet: &[(RealTimeSimulator, Daemon)], wanted: impl Fn(Mode) -> bool) {
    let begun = Instant::now();
    let is_wanted = |(_, daemon): &(_, Daemon)| wanted(daemon.snapshot().mode());
    while !fleet.iter().all(is_wanted) {
        let modes: Vec<_> = fleet
            .iter()
            .map(|(_, daemon)| daemon.snapshot().mode())
            .collect();
        assert!(begun.elapsed() < PATIENCE, "{modes:?}");
        thread::sleep(Duration::from_millis(5));
    }
}

/// When the reference began.
fn begun_ns(daemon: &Daemon) -> u64 {
    loop {
        let tick = daemon.snapshot().latest.tick.unwrap();
        if let Some(drive_time) = tick.output.drive_time {
            return tick.pilot_time.0 - (drive_time * 1e9).round() as u64;
        }
        assert_eq!(tick.output.mode, Mode::Driving, "{:?}", tick.output.reason);
        thread::sleep(Duration::from_millis(1));
    }
}

/// Starts `fleet arm`, sends it a signal once all cars drive, and returns when each car began to stop:
/// less by the longest time for which this process was not run.
fn begins_to_stop(
    folder: &Path,
    cars: &[(RealTimeSimulator, Daemon)],
    signal: &str,
) -> Vec<Duration> {
    wait(cars, |mode| mode == Mode::Ready);
    let mut arm = fleet(folder, &["arm", "--start-in", "1s"])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    wait(cars, |mode| mode == Mode::Driving);
    let begun = cars.iter().map(|(_, daemon)| begun_ns(daemon));
    let begun: Vec<_> = begun.collect();
    let apart = begun.iter().max().unwrap() - begun.iter().min().unwrap();
    println!("begun within {apart} ns");
    assert!(apart < 10_000_000, "{begun:?}");
    let status = fleet(folder, &["status"]).output().unwrap();
    let said = text(&status);
    assert!(
        said.contains("car1  driving") && said.contains("car2  driving"),
        "{said}"
    );
    let sent = Instant::now();
    let kill = Command::new("kill")
        .args([signal, &arm.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
    let mut stopped = vec![None; cars.len()];
    let (mut looked, mut late) = (sent, Duration::ZERO);
    while stopped.contains(&None) {
        late = late.max(looked.elapsed());
        looked = Instant::now();
        for ((_, daemon), stopped) in cars.iter().zip(&mut stopped) {
            if daemon.snapshot().mode() != Mode::Driving {
                stopped.get_or_insert(sent.elapsed());
            }
        }
        thread::sleep(Duration::from_millis(1));
    }
    wait(cars, |mode| !mode.commands());
    for (_, daemon) in cars {
        assert_eq!(daemon.snapshot().reason(), Some(Reason::OperatorGone));
    }
    arm.kill().unwrap();
    arm.wait().unwrap();
    stopped
        .into_iter()
        .flatten()
        .map(|time: Duration| time.saturating_sub(late))
        .collect()
}

#[test]
fn cars_stop_by_themselves_when_the_command_that_holds_them_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let cars = start(folder, &[car(0), car(1)], None);
    let early = fleet(folder, &["arm"]).output().unwrap();
    assert_eq!(early.status.code(), Some(1), "{}", text(&early));
    assert!(text(&early).contains("car1: not ready"), "{}", text(&early));

    for signal in ["-KILL", "-STOP"] {
        let times = begins_to_stop(folder, &cars, signal);
        println!("{signal}: {times:?}");
        let longest = Duration::from_millis(200);
        assert!(
            times.iter().all(|time| *time < longest),
            "{signal}: {times:?}"
        );
    }

    wait(&cars, |mode| mode == Mode::Ready);
    let timed = fleet(folder, &["arm", "--for", "1s", "--start-in", "1s"])
        .output()
        .unwrap();
    assert_eq!(timed.status.code(), Some(0), "{}", text(&timed));
    wait(&cars, |mode| mode == Mode::Ready);
    let file = folder.join("fleet.toml");
    let right = std::fs::read_to_string(&file).unwrap();
    for (key, wrong) in [
        (
            "number = 7",
            "number is 7, and board.car_id of its daemon is 0",
        ),
        (
            "body = \"it\"",
            "body is \"it\", and motion_capture.rigid_body of its daemon is \"",
        ),
    ] {
        let changed = right.replace("\"car2\"\n", &format!("\"car2\"\n{key}\n"));
        std::fs::write(&file, changed).unwrap();
        let other = fleet(folder, &["arm"]).output().unwrap();
        assert_eq!(other.status.code(), Some(1), "{}", text(&other));
        assert!(
            text(&other).contains(&format!("car2: {wrong}")),
            "{}",
            text(&other)
        );
    }
    // It is no reason not to stop.
    let stop = fleet(folder, &["stop"]).output().unwrap();
    assert!(stop.status.success(), "{}", text(&stop));
    for (_, daemon) in cars {
        daemon.stop().unwrap();
    }
    let gone = fleet(folder, &["disarm"]).output().unwrap();
    assert_eq!(gone.status.code(), Some(1));
    assert!(
        text(&gone).contains("car1: ") && text(&gone).contains("car2: "),
        "{}",
        text(&gone)
    );
}

#[test]
fn no_car_drives_on_when_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut uncalibrated = car(1);
    uncalibrated.config.supervisor.require_calibration = true;
    let cars = start(folder, &[car(0), uncalibrated], None);
    wait(&cars, |mode| mode == Mode::Ready);
    let arm = fleet(folder, &["arm"]).output().unwrap();
    assert_eq!(arm.status.code(), Some(1), "{}", text(&arm));
    assert!(
        text(&arm).contains("car2: ") && text(&arm).contains("no car drives"),
        "{}",
        text(&arm)
    );
    wait(&cars, |mode| !mode.commands());
    for (_, daemon) in cars {
        daemon.stop().unwrap();
    }
}

#[test]
fn all_daemons_hear_the_cameras_through_one_client_and_stop_when_it_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut client = None;
    let mut relay = |port: u16| {
        let mut child = Command::new(env!("CARGO_BIN_EXE_singletrack"))
            .args(["fleet", "cameras", "--server", "localhost", "--listen"])
            .args(["127.0.0.1:0", "--port", &port.to_string()])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = String::new();
        let output = child.stdout.take().unwrap();
        BufReader::new(output).read_line(&mut said).unwrap();
        client = Some(child);
        said.trim_end().rsplit(':').next().unwrap().parse().unwrap()
    };
    let cars = start(folder, &[car(0), car(1)], Some(&mut relay));
    let mut client = client.unwrap();
    wait(&cars, |mode| mode == Mode::Ready);
    let mut arm = fleet(folder, &["arm", "--start-in", "1s"])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    wait(&cars, |mode| mode == Mode::Driving);
    for (_, daemon) in &cars {
        begun_ns(daemon);
    }
    client.kill().unwrap();
    client.wait().unwrap();
    let killed = Instant::now();
    wait(&cars, |mode| mode != Mode::Driving);
    println!("the client is killed: {:?}", killed.elapsed());
    wait(&cars, |mode| !mode.commands());
    for (_, daemon) in cars {
        assert_eq!(daemon.snapshot().reason(), Some(Reason::PoseTooOld));
        daemon.stop().unwrap();
    }
    assert_eq!(arm.wait().unwrap().code(), Some(3));
}

#[test]
fn the_cameras_are_not_heard_through_themselves() {
    let arguments = ["fleet", "cameras", "--server", "127.0.0.1"];
    let command = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(arguments)
        .output()
        .unwrap();
    assert_eq!(command.status.code(), Some(1));
    assert!(
        text(&command).contains("cameras' own address"),
        "{}",
        text(&command)
    );
}
