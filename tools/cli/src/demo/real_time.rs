//! The drive in real time: the daemon's own threads, a pseudo-terminal and UDP packets, as with a
//! real car.

use std::{
    thread,
    time::{Duration, Instant},
};

use singletrack_pilot::{Mode, PilotRequest};
use singletrack_sim::RealTimeSimulator;
use singletrackd::{Daemon, Snapshot, StartOptions};

use super::{
    DemoArgs, DemoError,
    board_figures::BoardFigures,
    files::{CONFIGURATION, RECORD, SIMULATION, write},
    outcome::{Drive, Ended},
    progress::Progress,
    settings,
};
use crate::interrupt::Interrupt;

/// How long board, cameras and estimator may take to be ready.
const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long the car may take to stop and to be disarmed.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How often the demo looks at the daemon.
const POLL: Duration = Duration::from_millis(50);

/// Drives, and returns how it went.
pub(super) fn run(
    args: &DemoArgs,
    progress: &mut Progress,
    interrupt: &Interrupt,
) -> Result<Drive, DemoError> {
    let private = tempfile::Builder::new()
        .prefix("singletrack-")
        .tempdir()
        .map_err(DemoError::Temporary)?;
    let simulation = settings::simulation(args)?;
    let front_axle_distance_m = args.car.vehicle()?.front_axle_distance_m;
    let simulator =
        RealTimeSimulator::start(settings::real_time(simulation.clone(), private.path()))?;
    simulator.with_world(|world| world.cameras_mut().set_loss_epoch(None))?;
    let config = settings::connected(&simulator, args, private.path())?;
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
    let _viewers = super::viewers::Viewers::start(args, &socket, &[])?;
    let start_ns = start(&daemon, &simulator, progress, interrupt)?;
    let ended = drive(
        &daemon,
        &simulator,
        args.duration,
        start_ns,
        front_axle_distance_m,
        progress,
        interrupt,
    )?;
    stop(&daemon)?;
    let summary = daemon.stop()?;
    let mut finished = simulator.stop()?;
    let board = BoardFigures::of(finished.world.board_mut())?;
    Ok(Drive {
        ended,
        start_ns,
        duration_s: ended
            .as_ref()
            .map_or(args.duration.as_secs_f64(), |ended| ended.after_s),
        front_axle_distance_m,
        truth: finished.trajectory,
        summary: Some(summary),
        board,
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
        let held = snapshot.output().is_some_and(|output| output.held);
        progress.driving(time, &now.truth, error_m, held);
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
