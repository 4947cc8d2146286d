//! `singletrack-sim`: the real-time simulator, with the board behind a
//! pseudo-terminal and the cameras behind UDP.

mod hands_socket;

use std::{process::ExitCode, time::Duration};

use clap::Parser as _;
use singletrack_sim::{Arguments, NatNetParameters, RealTimeError, RealTimeSimulator, ServerKind};
use tokio::signal::unix::{SignalKind, signal};

#[tokio::main(flavor = "current_thread")]
async fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-sim: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    // First, so that no signal leaves the link behind.
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let config = arguments.config()?;
    let (kind, natnet) = (config.cameras, config.simulation.natnet);
    let up_axis = config.simulation.cameras.up_axis.name();
    let body = config.simulation.cameras.car.name.clone();
    let simulator = RealTimeSimulator::start(config)?;
    if !arguments.quiet {
        introduce(kind, &natnet, up_axis, &body, &simulator);
    }
    let end = async {
        match arguments.duration {
            Some(duration) => tokio::time::sleep(duration).await,
            None => core::future::pending().await,
        }
    };
    let hands = async {
        match &arguments.hands {
            Some(path) => hands_socket::serve(&simulator, path).await,
            None => core::future::pending().await,
        }
    };
    let failure = tokio::select! {
        error = hands => return Err(format!("the hands' socket: {error}").into()),
        _ = interrupt.recv() => None,
        _ = terminate.recv() => None,
        () = end => None,
        failure = board_failure(&simulator) => Some(failure?),
    };
    if let Some(path) = &arguments.hands {
        let _ = std::fs::remove_file(path);
    }
    let finished = simulator.stop()?;
    let failure = failure.or_else(|| finished.world.board().failure().map(str::to_owned));
    if let Some(failure) = failure {
        return Err(format!("the board failed: {failure}").into());
    }
    if !arguments.quiet {
        let truth = finished.world.truth();
        let cameras = finished.world.cameras().counters();
        println!(
            "stopped after {:.1} s at x {:.3} m, y {:.3} m, yaw {:.1} degrees; \
             {} camera frames, {} without the car",
            truth.time_us as f64 * 1e-6,
            truth.x,
            truth.y,
            truth.yaw.to_degrees(),
            cameras.exposed,
            cameras.lost,
        );
    }
    Ok(())
}

/// Period of the check for a failed image process. A board without it stays off.
const FAILURE_PERIOD: Duration = Duration::from_millis(100);

/// Waits until the process that runs the image fails; returns the error.
async fn board_failure(simulator: &RealTimeSimulator) -> Result<String, RealTimeError> {
    loop {
        tokio::time::sleep(FAILURE_PERIOD).await;
        let failure = simulator.with_world(|world| world.board().failure().map(str::to_owned))?;
        if let Some(failure) = failure {
            return Ok(failure);
        }
    }
}

fn introduce(
    kind: ServerKind,
    natnet: &NatNetParameters,
    up_axis: &str,
    body: &str,
    simulator: &RealTimeSimulator,
) {
    let address = simulator.command_address();
    let up_axis = up_axis.to_uppercase();
    println!("serial port  {}", simulator.pty_path().display());
    match kind {
        ServerKind::NatNet => println!(
            "NatNet       {address} (commands), {} (frames), bitstream {}, {}, {up_axis} up",
            simulator.data_address(),
            natnet.bitstream,
            if natnet.multicast {
                "multicast"
            } else {
                "unicast"
            },
        ),
        ServerKind::Vrpn => {
            println!("VRPN         {address} (TCP, and UDP on request), {up_axis} up");
        }
        ServerKind::Qualisys => println!(
            "Qualisys     {address} (little-endian; big-endian on the next port), {up_axis} up"
        ),
    }
    println!("rigid body   \"{body}\", its pivot above the centre of mass");
    println!("Ctrl-C stops.");
}
