//! `singletrack-sim`: the real-time simulator, with the board behind a
//! pseudo-terminal and the cameras behind UDP. On a Unix socket it takes commands of hands as lines.

use std::{convert::Infallible, io, path::Path, process::ExitCode, time::Duration};

use clap::Parser as _;
use singletrack_sim::{
    Arguments, HandCommand, RealTimeConfig, RealTimeError, RealTimeSimulator, Seen, ServerKind,
    SimulationConfig,
};
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    net::{UnixListener, UnixStream},
    signal::unix::{SignalKind, signal},
};

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
    let simulator = RealTimeSimulator::start(config.clone())?;
    if !arguments.quiet {
        introduce(&config, &simulator);
    }
    let end = async {
        match arguments.duration {
            Some(duration) => tokio::time::sleep(duration).await,
            None => core::future::pending().await,
        }
    };
    let hands = async {
        match &arguments.hands {
            Some(path) => serve_hands(&simulator, path).await,
            None => core::future::pending().await,
        }
    };
    let failure = tokio::select! {
        Err(error) = hands => return Err(format!("the hands' socket: {error}").into()),
        _ = interrupt.recv() => None,
        _ = terminate.recv() => None,
        () = end => None,
        failure = board_failure(&simulator) => Some(failure?),
    };
    if let Some(path) = &arguments.hands {
        let _ = std::fs::remove_file(path);
    }
    let finished = simulator.stop()?;
    let failure = failure.or_else(|| finished.world.board.failure().map(str::to_owned));
    if let Some(failure) = failure {
        return Err(format!("the board failed: {failure}").into());
    }
    if !arguments.quiet {
        let truth = finished.world.truth();
        let cameras = finished.world.cameras.counters;
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
        let failure = simulator.with_world(|world| world.board.failure().map(str::to_owned))?;
        if let Some(failure) = failure {
            return Ok(failure);
        }
    }
}

fn introduce(config: &RealTimeConfig, simulator: &RealTimeSimulator) {
    let SimulationConfig {
        cameras, natnet, ..
    } = &config.simulation;
    let (address, body) = (simulator.command_address, &cameras.car.name);
    let up_axis = cameras.up_axis.name().to_uppercase();
    println!("serial port  {}", simulator.pty_path.display());
    match config.cameras {
        ServerKind::NatNet => println!(
            "NatNet       {address} (commands), {} (frames), bitstream {}, {}, {up_axis} up",
            simulator.data_address,
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

/// How often it is looked whether a motion has ended.
const LOOK: Duration = Duration::from_millis(20);
/// A line is at most this long, in bytes.
const LONGEST: usize = 256;

/// Serves one person after the other; it ends only with an error.
async fn serve_hands(simulator: &RealTimeSimulator, path: &Path) -> io::Result<Infallible> {
    // The link of a simulator that was killed.
    let _ = std::fs::remove_file(path);
    let listener = UnixListener::bind(path)?;
    loop {
        let (stream, _) = listener.accept().await?;
        // A person who leaves is no failure.
        drop(attend(simulator, stream).await);
    }
}

/// Does what the lines say, each after the one before it has ended.
async fn attend(simulator: &RealTimeSimulator, mut stream: UnixStream) -> io::Result<()> {
    let (reader, mut writer) = stream.split();
    let mut lines = BufReader::new(reader).lines();
    while let Some(line) = lines.next_line().await? {
        let command = line
            .get(..LONGEST.min(line.len()))
            .map(str::parse::<HandCommand>);
        let answer = match command {
            Some(Ok(command)) => {
                let gone = |error| io::Error::other(format!("{error}"));
                simulator
                    .with_world(move |world| command.apply(world))
                    .map_err(gone)?;
                loop {
                    let (busy, text) = simulator
                        .with_world(|world| (world.car.is_in_motion_by_hand(), Seen::of(world)))
                        .map_err(gone)?;
                    if !busy {
                        break format!("ok {text}\n");
                    }
                    tokio::time::sleep(LOOK).await;
                }
            }
            Some(Err(error)) => format!("error: {error}\n"),
            None => "error: not a line of text\n".to_owned(),
        };
        writer.write_all(answer.as_bytes()).await?;
    }
    Ok(())
}
