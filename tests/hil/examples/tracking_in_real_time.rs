//! How closely P follows in real time, beside virtual time: scenarios of the simulated car, driven
//! by the shipped daemon over a pseudo-terminal and UDP.
//!
//! `cargo run --release -p singletrack-hil --example tracking_in_real_time -- tools/scenarios/best/*.toml`
//!
//! The error is that of the true car in both: the root mean square of the distance of P from its
//! reference at the same time. Printed too: how long after the arrival of a frame a tick begins,
//! and how late the ticks are. Nothing else should run on the machine.

#![allow(clippy::print_stdout, reason = "a program")]

use std::{path::Path, path::PathBuf, process::ExitCode, time::Duration};

use clap::Parser;
use singletrack_core::config::{
    Config, MotionCaptureSection, RecordSection, SerialSection, SocketSection, StateSection, UpAxis,
};
use singletrack_hil::{
    Failure, Outcome, client::Client, daemon, daemon::Daemon, ensure, percentile, settings, wait,
};
use singletrack_record::{Entry, Reader};
use singletrack_scenario::simulate::{Scenario, simulate, virtual_drive_config};
use singletrack_sim::{BoardKind, RealTimeConfig, RealTimeSimulator, TimedTruth};
use singletrack_statistics::RootMeanSquare;

/// From here on the start no longer counts, in s of the drive.
const SETTLED: f64 = 10.0;

/// Drive scenarios in real time and in virtual time.
#[derive(Debug, Parser)]
struct Options {
    /// Scenario files whose plant is the car
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Time of each drive, in s
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,

    /// Measure this singletrackd instead of building one
    #[arg(long, value_name = "PATH")]
    daemon: Option<PathBuf>,

    /// Board to simulate
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,
}

fn main() -> ExitCode {
    match run(Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("error: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: Options) -> Outcome {
    let daemon = options.daemon.map_or_else(daemon::build, Ok)?;
    println!(
        "virtual_mm real_mm ratio  after_frame_p50_ms p99_ms  late_p50_ms p99_ms largest_ms file"
    );
    for file in &options.files {
        let mut scenario = Scenario::read(file).map_err(failed(file))?;
        scenario.run.duration_s = options.seconds;
        let expected = virtual_mm(&scenario).map_err(failed(file))?;
        let real = drive(&scenario, &daemon, options.board)?;
        let [frame_50, frame_99] = [0.5, 0.99].map(|part| percentile(&real.after_frame_ms, part));
        let [late_50, late_99, late_most] =
            [0.5, 0.99, 1.0].map(|part| percentile(&real.late_ms, part));
        println!(
            "{expected:10.2} {:7.2} {:5.2} {frame_50:19.2} {frame_99:6.2} {late_50:12.3} \
             {late_99:6.3} {late_most:10.3} {}",
            real.error_mm,
            real.error_mm / expected,
            file.display()
        );
    }
    Ok(())
}

/// An error of a scenario's file.
fn failed<E: std::fmt::Display>(file: &Path) -> impl Fn(E) -> Failure {
    move |error| Failure::new(format!("{}: {error}", file.display()))
}

/// The error in virtual time, in mm.
fn virtual_mm(scenario: &Scenario) -> Result<f64, singletrack_scenario::simulate::SimulateError> {
    let mut error = RootMeanSquare::default();
    for row in simulate(scenario)?.rows {
        if row.t >= SETTLED {
            error.add_square((row.x_p - row.x_ref).powi(2) + (row.y_p - row.y_ref).powi(2));
        }
    }
    Ok(1e3 * error.value().unwrap_or(f64::NAN))
}

/// What a drive in real time was like.
struct Drive {
    error_mm: f64,
    /// From the arrival of the newest frame to the beginning of the tick.
    after_frame_ms: Vec<f64>,
    /// From the planned to the true beginning of a tick.
    late_ms: Vec<f64>,
}

/// The configuration of a daemon with everything in `folder`.
fn configuration(believed: Config, simulator: &RealTimeSimulator, folder: &Path) -> Config {
    let cameras = simulator.command_address();
    let mut config = believed;
    config.serial = SerialSection::new(simulator.pty_path());
    config.motion_capture = MotionCaptureSection {
        command_port: Some(cameras.port()),
        ..MotionCaptureSection::new(*cameras.ip(), "car", UpAxis::Y)
    };
    config.supervisor.require_calibration = false;
    config.record = RecordSection {
        enabled: true,
        directory: folder.join("records"),
        min_free_mb: 0,
    };
    config.state = StateSection {
        directory: folder.join("state"),
    };
    config.socket = SocketSection {
        enabled: true,
        path: settings::socket(folder),
        tcp_port: None,
        reference_folder: None,
    };
    config
}

fn drive(scenario: &Scenario, program: &Path, board: BoardKind) -> Outcome<Drive> {
    let name = Path::new("the scenario");
    let (believed, mut simulation) = virtual_drive_config(scenario).map_err(failed(name))?;
    let folder = tempfile::Builder::new()
        .prefix("singletrack-tracking-")
        .tempdir()
        .map_err(Failure::system("can't make a folder"))?;
    simulation.board.kind = board;
    let simulator = RealTimeSimulator::start(RealTimeConfig {
        simulation,
        pty_link: Some(folder.path().join("board")),
        trajectory_period_us: 1_000,
        ..RealTimeConfig::default()
    })?;
    let config = configuration(believed, &simulator, folder.path());
    let file = folder.path().join("singletrackd.toml");
    settings::write(&config, &file)?;
    let log = folder.path().join("daemon.log");
    let mut daemon = Daemon::start(program, &file, &log)?;
    let mut client = wait::until("the control socket", Duration::from_secs(5), || {
        Ok(Client::connect(&config.socket.path).ok())
    })?;
    wait::until("a ready car", Duration::from_secs(15), || {
        Ok((client.status()?.mode() == "ready").then_some(()))
    })?;
    client.arm()?.accepted()?;
    std::thread::sleep(Duration::from_secs_f64(scenario.run.duration_s));
    let status = client.status()?;
    ensure!(status.mode() == "driving", "it stopped: {}", status.text());
    let truth = simulator.take_trajectory()?;
    let (ended, _) = daemon.terminate(Duration::from_secs(5))?;
    ensure!(ended.success(), "the daemon ended with {ended}");
    evaluate(&config, &truth, &record(&config.record.directory)?)
}

/// The only record in a folder.
fn record(folder: &Path) -> Outcome<PathBuf> {
    let entries = folder.read_dir().map_err(Failure::system("no records"))?;
    let mut paths = entries.flatten().map(|entry| entry.path());
    paths.next().ok_or_else(|| Failure::new("no record"))
}

/// The true P against the reference between two ticks.
fn evaluate(config: &Config, truth: &[TimedTruth], record: &Path) -> Outcome<Drive> {
    let mut result = Drive {
        error_mm: f64::NAN,
        after_frame_ms: Vec::new(),
        late_ms: Vec::new(),
    };
    let mut error = RootMeanSquare::default();
    let (mut frames_ns, mut starts_ns) = (Vec::new(), Vec::new());
    let mut before = None;
    let mut truth = truth.iter().peekable();
    for entry in Reader::open(record).map_err(failed(record))? {
        let tick = match entry.map_err(failed(record))? {
            Entry::Pose(pose) => {
                frames_ns.push(pose.receive_time_ns);
                continue;
            }
            Entry::Tick(tick) => tick,
            _ => continue,
        };
        let settled = tick.output.drive_time.is_some_and(|time| time >= SETTLED);
        let place = tick.output.reference.and_then(|point| point.position);
        let (Some(place), true) = (place, settled) else {
            before = None;
            continue;
        };
        starts_ns.push(tick.start_ns);
        let late_ns = tick.start_ns.saturating_sub(tick.scheduled_ns);
        result.late_ms.push(late_ns as f64 * 1e-6);
        let now_ns = tick.pilot_time.0;
        if let Some((then_ns, then)) = before.replace((now_ns, place)) {
            while let Some(sample) = truth.next_if(|sample| sample.monotonic_ns < now_ns) {
                if sample.monotonic_ns < then_ns {
                    continue;
                }
                let part = (sample.monotonic_ns - then_ns) as f64 / (now_ns - then_ns) as f64;
                let reference = then + part * (place - then);
                let [x, y] = sample.truth.point_p(
                    config.law.front_axle_distance_m,
                    config.law.point_distance_m,
                );
                error.add_square((x - reference.x).powi(2) + (y - reference.y).powi(2));
            }
        }
    }
    result.error_mm = 1e3 * error.value().unwrap_or(f64::NAN);
    for start_ns in starts_ns {
        let frames = frames_ns.partition_point(|frame_ns| *frame_ns <= start_ns);
        if let Some(newest_ns) = frames.checked_sub(1).and_then(|last| frames_ns.get(last)) {
            let after_ns = start_ns - newest_ns;
            result.after_frame_ms.push(after_ns as f64 * 1e-6);
        }
    }
    result.after_frame_ms.sort_by(f64::total_cmp);
    result.late_ms.sort_by(f64::total_cmp);
    Ok(result)
}
