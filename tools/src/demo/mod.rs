//! `singletrack demo`: the paper's circle, driven by the daemon on the
//! simulated car, in real time.
//!
//! The daemon's own threads run in this process, its serial port is a
//! pseudo-terminal and its cameras are UDP packets: nothing of it knows that
//! the car is simulated.

mod board_figures;
mod progress;
mod report;
mod settings;

use std::{
    io,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use board_figures::BoardFigures;
use clap::Args;
use progress::Progress;
use singletrack_core::ConfigError;
use singletrack_pilot::{Mode, Reason, Request};
use singletrack_sim::{
    BoardKind, LossPattern, RealTimeError, RealTimeSimulator, TimedTruth, parse_duration_us,
};
use singletrackd::{Daemon, Snapshot, StartError, StartOptions, StopError, Summary};

use crate::{
    interrupt::Interrupt,
    plot::{FigureKind, PlotError, REPORT},
};

/// What the demo is told.
#[derive(Clone, Debug, Args)]
pub struct DemoArgs {
    /// How long to drive, such as 40s; a bare number is in seconds
    #[arg(long, value_name = "DURATION", default_value = "40s", value_parser = parse_duration)]
    duration: Duration,

    /// What runs on the board: its code, compiled for this machine, or the Arduino's
    /// image on a simulated processor (`cargo uno` builds it)
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,

    /// Where the configuration, the record, the figures and the summary go
    #[arg(long, value_name = "DIR", default_value = "singletrack-demo")]
    out: PathBuf,

    /// All random numbers of the simulation follow from this
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Add the reference's velocity to the position loop: the error goes to zero
    #[arg(long)]
    feed_forward: bool,

    /// Show the drive live, to Foxglove, Lichtblick and PlotJuggler on this machine: on
    /// port 8765 unless told another
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    live: Option<u16>,

    /// Lose the markers for a DURATION at every multiple of an INTERVAL, such as 200ms@2s
    #[arg(long, value_name = "DURATION@INTERVAL")]
    loss: Option<LossPattern>,
}

/// Why a demo failed.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// Something can't be written.
    #[error("can't write {}: {source}", path.display())]
    Write {
        /// What.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Ctrl-C can't be listened for.
    #[error("can't listen for signals: {0}")]
    Signals(io::Error),
    /// Somebody ended it early.
    #[error("interrupted")]
    Interrupted,
    /// No private folder for socket and port.
    #[error("can't make a temporary folder: {0}")]
    Temporary(io::Error),
    /// The simulator does not run.
    #[error("the simulator: {0}")]
    Simulator(#[from] RealTimeError),
    /// The UNO's image, or the processor that it ran on.
    #[error("the board: {0}")]
    Board(String),
    /// The daemon would not take its configuration.
    #[error("the configuration: {0}")]
    Config(#[from] ConfigError),
    /// The configuration can't be written as TOML.
    #[error("the configuration: {0}")]
    Toml(#[from] toml::ser::Error),
    /// The daemon does not start.
    #[error("the daemon: {0}")]
    Start(#[from] StartError),
    /// The daemon did not end well.
    #[error("the daemon: {0}")]
    Stop(#[from] StopError),
    /// There are no figures of the drive.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The daemon takes no requests.
    #[error("the daemon: {0}")]
    Stalled(#[from] singletrack_core::Stalled),
    /// The car was never ready, or did not start.
    #[error(
        "the car did not start within {seconds} s: mode {mode}{}",
        because(*reason)
    )]
    NotStarted {
        /// The mode that it stayed in.
        mode: Mode,
        /// Why.
        reason: Option<Reason>,
        /// How long it was given.
        seconds: u64,
    },
    /// The car stopped before its time.
    #[error(
        "the drive ended after {after_s:.1} s of {wanted_s:.1} s: mode {mode}{}; see {}{}",
        because(*reason), folder.display(), hint(*reason)
    )]
    Ended {
        /// The mode it went to.
        mode: Mode,
        /// Why.
        reason: Option<Reason>,
        /// How long it drove, in s.
        after_s: f64,
        /// How long it should have, in s.
        wanted_s: f64,
        /// Where its record is.
        folder: PathBuf,
    },
}

fn because(reason: Option<Reason>) -> String {
    reason.map_or_else(String::new, |reason| format!(", because of {reason}"))
}

/// What may be behind a stop that has nothing to do with the drive.
fn hint(reason: Option<Reason>) -> &'static str {
    match reason {
        Some(Reason::BoardFailsafe | Reason::ImuSilent | Reason::LinkDown) => {
            "\n(a command lives for 95 ms; a machine that is busy with other work can hold up \
             a pseudo-terminal for longer: is this one?)"
        }
        _ => "",
    }
}

fn parse_duration(text: &str) -> Result<Duration, String> {
    let micros = match text.trim().parse::<u32>() {
        Ok(seconds) => u64::from(seconds) * 1_000_000,
        Err(_) => parse_duration_us(text).map_err(|error| error.to_string())?,
    };
    if (100_000..=86_400_000_000).contains(&micros) {
        Ok(Duration::from_micros(micros))
    } else {
        Err(format!("{text} is not between 0.1s and 86400s"))
    }
}

/// How long board, cameras and estimator may take to be ready.
const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long the car may take to stop and to be disarmed.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How often the demo looks at the daemon.
const POLL: Duration = Duration::from_millis(50);

/// A drive that has come to its end, for the report.
#[derive(Debug)]
struct Drive {
    /// How it ended before its time, if it did.
    ended: Option<Ended>,
    /// CLOCK_MONOTONIC of the first driving tick, in ns.
    start_ns: u64,
    /// How long the car drove, in s.
    duration_s: f64,
    /// Where the car truly was.
    truth: Vec<TimedTruth>,
    /// What the daemon counted.
    summary: Summary,
    /// What the image took of its processor.
    board: Option<BoardFigures>,
}

/// Runs the demo.
///
/// # Errors
///
/// What kept the car from driving to the end; what there is of record and
/// figures is written all the same.
pub fn run(args: &DemoArgs) -> Result<(), DemoError> {
    let interrupt = Interrupt::listen().map_err(DemoError::Signals)?;
    prepare(&args.out)?;
    let private = tempfile::Builder::new()
        .prefix("singletrack-")
        .tempdir()
        .map_err(DemoError::Temporary)?;
    let simulation = settings::simulation(args);
    let simulator =
        RealTimeSimulator::start(settings::real_time(simulation.clone(), private.path()))?;
    simulator.with_world(|world| world.cameras_mut().set_loss_epoch(None))?;
    let config = settings::daemon(&simulator, args, private.path());
    write(&args.out.join(CONFIGURATION), &config.to_toml()?)?;
    write(&args.out.join(SIMULATION), &toml::to_string(&simulation)?)?;

    let daemon = Daemon::start(
        config,
        StartOptions {
            record: Some(args.out.join(RECORD)),
            seed: Some(args.seed),
            ..StartOptions::default()
        },
    )?;
    if let Some(live) = daemon.snapshot().live {
        eprintln!(
            "Live view: ws://{} (open a WebSocket connection in Foxglove, Lichtblick or \
             PlotJuggler)",
            live.address
        );
    }
    let expected = settings::expected(args.feed_forward);
    let mut progress = Progress::new(args.duration, expected.error_m);
    let start_ns = start(&daemon, &simulator, &progress, &interrupt)?;
    let ended = drive(
        &daemon,
        &simulator,
        args.duration,
        start_ns,
        &mut progress,
        &interrupt,
    )?;
    stop(&daemon)?;
    let summary = daemon.stop()?;
    let mut finished = simulator.stop()?;
    let board = BoardFigures::of(finished.world.board_mut())?;
    progress.finish();

    let driven = Drive {
        ended,
        start_ns,
        duration_s: ended
            .as_ref()
            .map_or(args.duration.as_secs_f64(), |ended| ended.after_s),
        truth: finished.trajectory,
        summary,
        board,
    };
    let plotted = report::plot(args, &driven.truth);
    report::write(args, &driven, plotted.is_ok())?;
    if let (Some(_), Err(error)) = (&driven.ended, &plotted) {
        // Why the drive ended matters more, and comes last.
        eprintln!("singletrack: no figures: {error}");
    }
    match driven.ended {
        None => Ok(plotted?),
        Some(_) if interrupt.is_raised() => Err(DemoError::Interrupted),
        Some(ended) => Err(DemoError::Ended {
            mode: ended.mode,
            reason: ended.reason,
            after_s: ended.after_s,
            wanted_s: args.duration.as_secs_f64(),
            folder: args.out.clone(),
        }),
    }
}

/// The files of a demo.
const RECORD: &str = "demo.mcap";
const CONFIGURATION: &str = "demo.toml";
const SIMULATION: &str = "simulation.toml";
const SUMMARY: &str = "summary.json";
/// A folder.
const FIGURES: &str = "figures";

/// Makes the folder; removes what an earlier demo left there.
fn prepare(folder: &Path) -> Result<(), DemoError> {
    let error = |source| DemoError::Write {
        path: folder.to_owned(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(error)?;
    let unfinished = singletrack_record::part_path(Path::new(RECORD));
    let files = [RECORD, CONFIGURATION, SIMULATION, SUMMARY, REPORT].map(PathBuf::from);
    let figures = FigureKind::ALL.map(|kind| Path::new(FIGURES).join(kind.file_name()));
    for file in files.into_iter().chain([unfinished]).chain(figures) {
        match std::fs::remove_file(folder.join(file)) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => return Err(error(source)),
            _ => {}
        }
    }
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<(), DemoError> {
    std::fs::write(path, text).map_err(|source| DemoError::Write {
        path: path.to_owned(),
        source,
    })
}

/// Waits until the car can drive, arms it, and waits until it does. Returns
/// CLOCK_MONOTONIC of its first driving tick, in ns.
fn start(
    daemon: &Daemon,
    simulator: &RealTimeSimulator,
    progress: &Progress,
    interrupt: &Interrupt,
) -> Result<u64, DemoError> {
    let begin = Instant::now();
    let mut armed = false;
    loop {
        if interrupt.is_raised() {
            return Err(DemoError::Interrupted);
        }
        let snapshot = daemon.snapshot();
        progress.waiting(snapshot.mode(), snapshot.reason());
        match snapshot.mode() {
            Mode::Ready if !armed => {
                daemon.request(Request::Arm)?;
                armed = true;
            }
            Mode::Driving => {
                if let Some(start_ns) = drive_start_ns(&snapshot) {
                    let epoch_us = start_ns.saturating_sub(simulator.started_ns()) / 1000;
                    simulator.with_world(move |world| {
                        world.cameras_mut().set_loss_epoch(Some(epoch_us));
                    })?;
                    return Ok(start_ns);
                }
            }
            mode if begin.elapsed() > READY_TIMEOUT => {
                return Err(DemoError::NotStarted {
                    mode,
                    reason: snapshot.reason(),
                    seconds: READY_TIMEOUT.as_secs(),
                });
            }
            _ => {}
        }
        thread::sleep(POLL);
    }
}

fn drive_start_ns(snapshot: &Snapshot) -> Option<u64> {
    let tick = snapshot.tick?;
    let driven_ns = (tick.drive_time_s? * 1e9) as u64;
    Some(tick.start_ns.saturating_sub(driven_ns))
}

/// A drive that ended before its time.
#[derive(Clone, Copy, Debug)]
struct Ended {
    mode: Mode,
    reason: Option<Reason>,
    after_s: f64,
}

/// Watches the drive for its duration.
fn drive(
    daemon: &Daemon,
    simulator: &RealTimeSimulator,
    duration: Duration,
    start_ns: u64,
    progress: &mut Progress,
    interrupt: &Interrupt,
) -> Result<Option<Ended>, DemoError> {
    let wanted_s = duration.as_secs_f64();
    let mut last_s = 0.0;
    loop {
        let snapshot = daemon.snapshot();
        let drives = matches!(snapshot.mode(), Mode::Driving | Mode::Slowing);
        if !drives || daemon.has_ended() || interrupt.is_raised() {
            return Ok(Some(Ended {
                mode: snapshot.mode(),
                reason: snapshot.reason(),
                after_s: last_s,
            }));
        }
        let now = simulator.truth()?;
        let time = now.monotonic_ns.saturating_sub(start_ns) as f64 * 1e-9;
        if time >= wanted_s {
            return Ok(None);
        }
        last_s = time;
        progress.driving(time, settings::tracking_error(&now.truth, time), &snapshot);
        let remaining = Duration::from_secs_f64(wanted_s - time);
        thread::sleep(POLL.min(remaining));
    }
}

/// Asks the car to stop and waits until it is disarmed.
fn stop(daemon: &Daemon) -> Result<(), DemoError> {
    let begin = Instant::now();
    if daemon.snapshot().mode().is_underway() {
        daemon.request(Request::Disarm)?;
        // The request is taken at the next tick.
        thread::sleep(POLL);
    }
    while daemon.snapshot().mode().commands()
        && begin.elapsed() < STOP_TIMEOUT
        && !daemon.has_ended()
    {
        thread::sleep(POLL);
    }
    Ok(())
}
