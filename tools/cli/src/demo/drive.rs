//! The drive of one car: in real time, with the daemon's own threads, a pseudo-terminal and UDP
//! packets, as with a real car; or in virtual time, with the same host loop, board and cameras on one
//! thread.

use std::{
    any::Any,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use singletrack_core::config::PageSection;
use singletrack_pilot::{Arming, Mode, PilotRequest};
use singletrack_scenario::{virtual_drive::VirtualDrive, virtual_record::VirtualRecord};
use singletrack_sim::{RealTimeSimulator, TimedTruth};
use singletrack_viewers::page::{OtherCar, Page};
use singletrackd::{Daemon, Snapshot};

use super::{
    Demo, DemoArgs, Drive, Ended, INTERRUPTED, NotStarted,
    report::BoardFigures,
    settings::{self, DEMO, RECORD, private, write_configuration},
};
use crate::Result;

/// How long board, cameras and estimator may take to be ready.
const READY_TIMEOUT: Duration = Duration::from_secs(15);
/// How long the car may take to stop and to be disarmed.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How often the demo looks at the daemon.
const POLL: Duration = Duration::from_millis(50);

/// Drives in real time, and returns how it went.
pub(super) fn real_time(demo: &Demo<'_>) -> Result<Drive> {
    let args = demo.args;
    let private = private()?;
    let simulation = settings::write_simulation(args)?;
    let config = settings::daemon(args)?;
    let front_axle_distance_m = config.vehicle.front_axle_distance_m;
    let simulator = settings::simulator(simulation, None, private.path())?;
    simulator.with_world(|world| world.cameras.loss_epoch_us = None)?;
    let daemon = settings::start(args, DEMO, config, args.seed, &simulator, private.path())?;
    let _viewers = viewers(args, [settings::socket(private.path())].into_iter())?;
    let start_ns = start(demo, &daemon, &simulator)?;
    let wanted_s = args.duration.as_secs_f64();
    let mut last_s = 0.0;
    let ended = loop {
        let snapshot = daemon.snapshot();
        let drives = matches!(snapshot.mode(), Mode::Driving | Mode::Slowing);
        if !drives || daemon.ended_thread().is_some() || demo.interrupt.is_raised() {
            break Some(Ended {
                mode: snapshot.mode(),
                reason: snapshot.reason(),
                after_s: last_s,
            });
        }
        let now = simulator.truth()?;
        let time = now.monotonic_ns.saturating_sub(start_ns) as f64 * 1e-9;
        if time >= wanted_s {
            break None;
        }
        last_s = time;
        let point = settings::point(&now.truth, front_axle_distance_m);
        let held = snapshot.output().is_some_and(|output| output.held);
        demo.driving(time, &now.truth, point, held);
        thread::sleep(POLL.min(Duration::from_secs_f64(wanted_s - time)));
    };
    stop(&[&daemon])?;
    let summary = daemon.stop()?;
    let mut finished = simulator.stop()?;
    Ok(Drive {
        ended,
        start_ns,
        duration_s: ended.map_or(wanted_s, |ended| ended.after_s),
        front_axle_distance_m,
        truth: finished.trajectory,
        summary: Some(summary),
        board: BoardFigures::of(&mut finished.world.board)?,
    })
}

/// Starts what shows the drive while it goes on, as the options ask, for the daemons at these sockets:
/// servers that end when the result is dropped; and prints their addresses.
pub(super) fn viewers(
    args: &DemoArgs,
    mut sockets: impl Iterator<Item = PathBuf>,
) -> Result<Vec<Box<dyn Any>>> {
    let mut viewers: Vec<Box<dyn Any>> = Vec::new();
    let socket = sockets.next().unwrap_or_default();
    if let Some(port) = args.watch {
        let section = PageSection {
            port,
            ..PageSection::default()
        };
        let other = |socket| OtherCar {
            socket,
            colour: None,
        };
        let page = Page::start(socket.clone(), sockets.map(other).collect(), &section)?;
        eprintln!("Watch the drive in a browser: http://{}", page.address);
        viewers.push(Box::new(page));
    }
    #[cfg(feature = "live")]
    if let Some(port) = args.live {
        let section = singletrack_core::config::LiveSection {
            port,
            ..Default::default()
        };
        let live = singletrack_viewers::live::Live::start(socket, section)?;
        eprintln!(
            "Live view: ws://{} (open a WebSocket connection in Foxglove, Lichtblick or PlotJuggler)",
            live.address
        );
        viewers.push(Box::new(live));
    }
    Ok(viewers)
}

/// Waits until the car can drive, arms it, and waits until it does. Returns
/// CLOCK_MONOTONIC of its first driving tick, in ns.
fn start(demo: &Demo<'_>, daemon: &Daemon, simulator: &RealTimeSimulator) -> Result<u64> {
    arm(demo, &[daemon], READY_TIMEOUT, |snapshot| {
        demo.waiting(snapshot.mode(), snapshot.reason());
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
    demo: &Demo<'_>,
    daemons: &[&Daemon],
    timeout: Duration,
    show: impl Fn(&Snapshot),
) -> Result<()> {
    let begin = Instant::now();
    for wanted in [Mode::Ready, Mode::Driving] {
        let waits = |daemon: &&Daemon| Some(daemon.snapshot()).filter(|it| it.mode() != wanted);
        while let Some(snapshot) = daemons.iter().find_map(waits) {
            if demo.interrupt.is_raised() {
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

/// Asks cars to stop, and waits until they are disarmed.
pub(super) fn stop(daemons: &[&Daemon]) -> Result<()> {
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

/// Drives in virtual time, and returns how it went.
pub(super) fn virtual_time(demo: &Demo<'_>) -> Result<Drive> {
    let args = demo.args;
    let simulation = settings::write_simulation(args)?;
    let config = settings::daemon(args)?;
    write_configuration(args, DEMO, &config)?;
    let front_axle_distance_m = config.vehicle.front_axle_distance_m;
    let mut drive = VirtualDrive::new(config.clone(), args.seed, simulation)?;
    drive.world.cameras.loss_epoch_us = None;
    let record = args.out.join(RECORD);
    let mut record = VirtualRecord::start(Some(&record), &mut drive, &config, args.seed)?;
    let first = drive.start()?;
    drive.world.cameras.loss_epoch_us = Some(drive.now_us());

    let wanted_s = args.duration.as_secs_f64();
    let (mut truth, mut last_s) = (Vec::new(), 0.0);
    let ended = loop {
        let tick = drive.step();
        record.write(&mut drive)?;
        truth.push(TimedTruth {
            monotonic_ns: tick.now.0,
            truth: tick.truth,
        });
        let output = &tick.tick.output;
        if !matches!(output.mode, Mode::Driving | Mode::Slowing) || demo.interrupt.is_raised() {
            break Some(Ended {
                mode: output.mode,
                reason: output.reason,
                after_s: last_s,
            });
        }
        let time = tick.now.seconds_since(first.now);
        if time >= wanted_s {
            break None;
        }
        last_s = time;
        let point = settings::point(&tick.truth, front_axle_distance_m);
        demo.driving(time, &tick.truth, point, output.held);
    };
    if drive.mode().is_underway() {
        drive.request(PilotRequest::Disarm)?;
    }
    let mut now = drive.step().now;
    let until = now.after(STOP_TIMEOUT.as_secs_f64());
    while drive.mode().commands() && now < until {
        now = drive.step().now;
    }
    record.finish(&mut drive)?;
    Ok(Drive {
        ended,
        start_ns: first.now.0,
        duration_s: ended.map_or(wanted_s, |ended| ended.after_s),
        front_axle_distance_m,
        truth,
        summary: None,
        board: BoardFigures::of(&mut drive.world.board)?,
    })
}
