//! `singletrack demo`: the paper's circle, driven by the daemon on the
//! simulated car, in real time.
//!
//! The daemon's own threads run in this process, its serial port is a
//! pseudo-terminal and its cameras are UDP packets, as with a real car.

mod arguments;
mod board_figures;
mod error;
mod files;
mod outcome;
mod progress;
mod report;
mod settings;
#[cfg(any(feature = "live", feature = "page"))]
mod viewers;

use std::{
    thread,
    time::{Duration, Instant},
};

use singletrack_pilot::{Mode, PilotRequest};
use singletrack_sim::RealTimeSimulator;
use singletrackd::{Daemon, Snapshot, StartOptions};

use crate::interrupt::Interrupt;
use board_figures::BoardFigures;
use files::{CONFIGURATION, RECORD, SIMULATION, prepare, write};
use outcome::{Drive, Ended};
use progress::Progress;

pub use arguments::DemoArgs;
pub use error::DemoError;

/// How long board, cameras and estimator may take to be ready.
const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long the car may take to stop and to be disarmed.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How often the demo looks at the daemon.
const POLL: Duration = Duration::from_millis(50);

/// Runs the demo.
///
/// # Errors
///
/// Why the car did not drive to the end; the record and the figures so far are
/// written all the same.
pub fn run(args: &DemoArgs) -> Result<(), DemoError> {
    let lacks_live = args.live.is_some() && !cfg!(feature = "live");
    let lacks_page = args.watch.is_some() && !cfg!(feature = "page");
    for (option, feature, lacks) in [
        ("--live", "live", lacks_live),
        ("--watch", "page", lacks_page),
    ] {
        if lacks {
            return Err(DemoError::NotBuilt { option, feature });
        }
    }
    let interrupt = Interrupt::listen().map_err(DemoError::Signals)?;
    prepare(&args.out)?;
    let private = tempfile::Builder::new()
        .prefix("singletrack-")
        .tempdir()
        .map_err(DemoError::Temporary)?;
    let simulation = settings::simulation(args)?;
    let front_axle_distance_m = args.car.vehicle()?.front_axle_distance_m;
    let simulator =
        RealTimeSimulator::start(settings::real_time(simulation.clone(), private.path()))?;
    simulator.with_world(|world| world.cameras_mut().set_loss_epoch(None))?;
    let config = settings::daemon(&simulator, args, private.path())?;
    write(&args.out.join(CONFIGURATION), &config.to_toml()?)?;
    write(&args.out.join(SIMULATION), &toml::to_string(&simulation)?)?;

    #[cfg(any(feature = "live", feature = "page"))]
    let socket = config.socket.path.clone();
    let daemon = Daemon::start(
        config,
        StartOptions {
            record: Some(args.out.join(RECORD)),
            seed: Some(args.seed),
            ..StartOptions::default()
        },
    )?;
    #[cfg(any(feature = "live", feature = "page"))]
    let _viewers = viewers::Viewers::start(args, &socket)?;
    let expected = settings::expected(args.feed_forward);
    let mut progress = Progress::new(args.duration, expected.error_m);
    let start_ns = start(&daemon, &simulator, &progress, &interrupt)?;
    let ended = drive(
        &daemon,
        &simulator,
        args.duration,
        start_ns,
        front_axle_distance_m,
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
        front_axle_distance_m,
        truth: finished.trajectory,
        summary,
        board,
    };
    let plotted = report::plot(args, &driven);
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
                daemon.request(PilotRequest::Arm)?;
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
    let tick = snapshot.tick.as_ref()?;
    let driven_ns = (tick.output.drive_time? * 1e9) as u64;
    Some(tick.start_ns.saturating_sub(driven_ns))
}

/// Watches the drive for its duration.
fn drive(
    daemon: &Daemon,
    simulator: &RealTimeSimulator,
    duration: Duration,
    start_ns: u64,
    front_axle_distance_m: f64,
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
        let point = settings::point(&now.truth, front_axle_distance_m);
        let error_m = settings::tracking_error(point, time);
        progress.driving(time, &now.truth, error_m, &snapshot);
        let remaining = Duration::from_secs_f64(wanted_s - time);
        thread::sleep(POLL.min(remaining));
    }
}

/// Asks the car to stop and waits until it is disarmed.
fn stop(daemon: &Daemon) -> Result<(), DemoError> {
    let begin = Instant::now();
    if daemon.snapshot().mode().is_underway() {
        daemon.request(PilotRequest::Disarm)?;
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
