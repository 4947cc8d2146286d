//! The drive in real time: the daemon's own threads, a pseudo-terminal and UDP packets, as with a
//! real car.

use std::{
    error::Error,
    thread,
    time::{Duration, Instant},
};

use singletrack_figures::output::write;
use singletrack_pilot::{Arming, Mode, PilotRequest};
use singletrack_sim::RealTimeSimulator;
use singletrackd::{Daemon, Snapshot};

use super::{
    DemoArgs, Drive, Ended, INTERRUPTED, NotStarted, Progress,
    files::{BoardFigures, CONFIGURATION, RECORD, SIMULATION, private},
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
) -> Result<Drive, Box<dyn Error>> {
    let private = private()?;
    let simulation = settings::simulation(args)?;
    let front_axle_distance_m = args.car.vehicle()?.front_axle_distance_m;
    let simulator =
        RealTimeSimulator::start(settings::real_time(simulation.clone(), private.path()))?;
    simulator.with_world(|world| world.cameras.loss_epoch_us = None)?;
    let mut config = settings::daemon(args)?;
    settings::connect(&simulator, &mut config, private.path());
    write(&args.out.join(CONFIGURATION), &config.to_toml()?)?;
    write(&args.out.join(SIMULATION), &toml::to_string(&simulation)?)?;

    let socket = config.socket.path.clone();
    let options = settings::options(args.out.join(RECORD), args.seed);
    let daemon = Daemon::start(config, options)?;
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
    stop(&[&daemon])?;
    let summary = daemon.stop()?;
    let mut finished = simulator.stop()?;
    let board = BoardFigures::of(&mut finished.world.board)?;
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
) -> Result<u64, Box<dyn Error>> {
    arm(&[daemon], READY_TIMEOUT, interrupt, |snapshot| {
        progress.waiting(snapshot.mode(), snapshot.reason());
    })?;
    let snapshot = daemon.snapshot();
    let start_ns =
        drive_start_ns(&snapshot).ok_or_else(|| not_started(&snapshot, READY_TIMEOUT))?;
    let epoch_us = start_ns.saturating_sub(simulator.started_ns) / 1000;
    simulator.with_world(move |world| world.cameras.loss_epoch_us = Some(epoch_us))?;
    Ok(start_ns)
}

/// Waits until all cars are ready, arms them, and waits until all drive. `show` is given one that is
/// waited for.
pub(super) fn arm(
    daemons: &[&Daemon],
    timeout: Duration,
    interrupt: &Interrupt,
    show: impl Fn(&Snapshot),
) -> Result<(), Box<dyn Error>> {
    let begin = Instant::now();
    for wanted in [Mode::Ready, Mode::Driving] {
        let waits = |daemon: &&Daemon| Some(daemon.snapshot()).filter(|it| it.mode() != wanted);
        while let Some(snapshot) = daemons.iter().find_map(waits) {
            if interrupt.is_raised() {
                return Err(INTERRUPTED.into());
            }
            if begin.elapsed() > timeout {
                return Err(not_started(&snapshot, timeout).into());
            }
            show(&snapshot);
            thread::sleep(POLL);
        }
        if wanted == Mode::Ready {
            for daemon in daemons {
                daemon.request(PilotRequest::Arm(Arming::Unattended))?;
            }
        }
    }
    Ok(())
}

fn not_started(snapshot: &Snapshot, timeout: Duration) -> NotStarted {
    NotStarted {
        mode: snapshot.mode(),
        reason: snapshot.reason(),
        seconds: timeout.as_secs(),
    }
}

fn drive_start_ns(snapshot: &Snapshot) -> Option<u64> {
    let tick = snapshot.latest.tick.as_ref()?;
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
) -> Result<Option<Ended>, Box<dyn Error>> {
    let wanted_s = duration.as_secs_f64();
    let mut last_s = 0.0;
    loop {
        let snapshot = daemon.snapshot();
        let drives = matches!(snapshot.mode(), Mode::Driving | Mode::Slowing);
        if !drives || daemon.ended_thread().is_some() || interrupt.is_raised() {
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

/// Asks cars to stop, and waits until they are disarmed.
pub(super) fn stop(daemons: &[&Daemon]) -> Result<(), Box<dyn Error>> {
    let begin = Instant::now();
    for daemon in daemons {
        if daemon.snapshot().mode().is_underway() {
            daemon.request(PilotRequest::Disarm)?;
        }
    }
    let commands =
        |daemon: &&Daemon| daemon.snapshot().mode().commands() && daemon.ended_thread().is_none();
    // The request is taken at the next tick.
    thread::sleep(POLL);
    while daemons.iter().any(commands) && begin.elapsed() < STOP_TIMEOUT {
        thread::sleep(POLL);
    }
    Ok(())
}
