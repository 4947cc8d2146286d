//! The options of `singletrack-sim`, as a library for its manual page.

use std::{net::Ipv4Addr, path::PathBuf, time::Duration};

use clap::Parser;
use singletrack_mocap::{
    DEFAULT_COMMAND_PORT, DEFAULT_QUALISYS_PORT, DEFAULT_VRPN_PORT, codec::BitstreamVersion,
};

use crate::{
    BoardKind, LossKind, LossPattern, LossPatternError, RealTimeConfig, ServerKind,
    SimulationConfig, SimulationFileError, StartPose, UdpConfig, parse_bitstream,
    parse_duration_us,
};

/// Where the daemon's example configuration can drive from.
const START: StartPose = StartPose {
    x_m: 0.57,
    y_m: -0.39,
    yaw_rad: 54_f64.to_radians(),
};

/// Simulate the car, the board and the motion capture system in real time.
///
/// The board's serial port is a pseudo-terminal; the motion capture system is a
/// NatNet, VRPN or Qualisys server. Put their addresses in the daemon's configuration: the
/// daemon then drives the simulated car like the real one. Stop with Ctrl-C.
#[derive(Debug, Parser)]
#[command(name = "singletrack-sim", version)]
pub struct Arguments {
    /// Configuration of the simulation; other options replace what it says
    ///
    /// A TOML file with the sections of the simulation (`[car.servo]`, `[cameras]`, ...),
    /// and a table `[truth]` as in a scenario: what is true of the car and differs from
    /// its configuration. Times in it count from the start of the simulator.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,

    /// Board to simulate: its code, compiled for this machine, or the UNO image on
    /// a simulated processor (built by `cargo uno`) [default: native]
    #[arg(long, value_name = "native|uno")]
    board: Option<BoardKind>,

    /// Path of the link to the board's serial port
    #[arg(long, value_name = "PATH", default_value = "/tmp/singletrack-board")]
    port: PathBuf,

    /// What the motion capture system speaks
    #[arg(long, value_name = "natnet|vrpn|qualisys", default_value = "natnet",
          value_parser = parse_server)]
    cameras: ServerKind,

    /// Address of the interface for the motion capture
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    interface: Ipv4Addr,

    /// Port of the motion capture (0: any free port) [default: 1510 for NatNet, on UDP; 3883 for
    /// VRPN; 22223 and the next for Qualisys, little- and big-endian]
    #[arg(long, value_name = "PORT")]
    command_port: Option<u16>,

    /// UDP port for NatNet frames (0: any free port)
    #[arg(long, value_name = "PORT", default_value_t = 1511)]
    data_port: u16,

    /// Send frames to the multicast group 239.255.42.99 instead of to each client
    #[arg(long)]
    multicast: bool,

    /// NatNet bitstream version, 2.7 to 4.4 [default: 4.1]
    #[arg(long, value_name = "VERSION", value_parser = parse_bitstream)]
    bitstream: Option<BitstreamVersion>,

    /// Seed of all random numbers [default: 1]
    #[arg(long)]
    seed: Option<u64>,

    /// Initial position of the centre of mass, in metres, and yaw, in degrees
    /// [default: 0.57,-0.39,54, from where the daemon's example drives; with --config, what
    /// the file says]
    #[arg(long, value_name = "X,Y,YAW", allow_hyphen_values = true, value_parser = parse_pose)]
    start: Option<StartPose>,

    /// Lose the markers for DURATION at every multiple of INTERVAL, such as 200ms@2s
    #[arg(long, value_name = "DURATION@INTERVAL")]
    loss: Option<LossPattern>,

    /// Form of a loss: tracking bit cleared (occluded, the default), body absent, or no
    /// frame (silent)
    #[arg(long, value_name = "KIND", value_parser = parse_loss_kind)]
    loss_kind: Option<LossKind>,

    /// Probability that a byte on the serial line has a bit flipped [default: 0]
    #[arg(long, value_name = "PROBABILITY")]
    corrupt: Option<f64>,

    /// Probability that a byte on the serial line is lost [default: 0]
    #[arg(long, value_name = "PROBABILITY")]
    drop: Option<f64>,

    /// Stop after this long, such as 40s; without it, run until Ctrl-C
    #[arg(long, value_name = "DURATION", value_parser = parse_duration)]
    pub duration: Option<Duration>,

    /// Unix socket that takes what a person does to the car, as lines
    ///
    /// The answer to each is what the person sees. `lift 0.1`, `roll 0.5 0.4`, `look`;
    /// any other line answers with the list of all.
    #[arg(long, value_name = "PATH")]
    pub hands: Option<PathBuf>,

    /// Print only errors
    #[arg(long, short)]
    pub quiet: bool,
}

fn parse_duration(text: &str) -> Result<Duration, LossPatternError> {
    parse_duration_us(text).map(Duration::from_micros)
}

fn parse_server(text: &str) -> Result<ServerKind, String> {
    ServerKind::named(text).ok_or_else(|| "choose natnet, vrpn or qualisys".to_owned())
}

fn parse_loss_kind(text: &str) -> Result<LossKind, String> {
    LossKind::named(text).ok_or_else(|| "choose occluded, absent or silent".to_owned())
}

fn parse_pose(text: &str) -> Result<StartPose, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[x_m, y_m, yaw_deg]) if [x_m, y_m, yaw_deg].iter().all(|x| x.is_finite()) => {
            Ok(StartPose {
                x_m,
                y_m,
                yaw_rad: yaw_deg.to_radians(),
            })
        }
        _ => Err(
            "write three numbers: x and y in metres, yaw in degrees; for instance 1.5,-0.5,135"
                .to_owned(),
        ),
    }
}

impl Arguments {
    /// The simulation that the options ask for.
    ///
    /// # Errors
    ///
    /// The file of the simulation can't be read.
    // Compiled where it is called, as the reading of the file is.
    #[inline]
    pub fn config(&self) -> Result<RealTimeConfig, SimulationFileError> {
        let mut simulation = match &self.config {
            Some(path) => SimulationConfig::read(path)?,
            None => {
                let mut simulation = SimulationConfig::default();
                simulation.car.start = START;
                simulation
            }
        };
        replace(&mut simulation.board.kind, self.board);
        replace(&mut simulation.seed, self.seed);
        replace(&mut simulation.car.start, self.start);
        replace(&mut simulation.wire.faults.corrupt, self.corrupt);
        replace(&mut simulation.wire.faults.drop, self.drop);
        replace(&mut simulation.cameras.loss_kind, self.loss_kind);
        replace(&mut simulation.natnet.bitstream, self.bitstream);
        simulation.cameras.loss = self.loss.or(simulation.cameras.loss);
        simulation.natnet.multicast |= self.multicast;
        Ok(RealTimeConfig {
            simulation,
            pty_link: Some(self.port.clone()),
            cameras: self.cameras,
            udp: UdpConfig {
                interface: self.interface,
                command_port: self.command_port.unwrap_or(match self.cameras {
                    ServerKind::NatNet => DEFAULT_COMMAND_PORT,
                    ServerKind::Vrpn => DEFAULT_VRPN_PORT,
                    ServerKind::Qualisys => DEFAULT_QUALISYS_PORT,
                }),
                data_port: self.data_port,
            },
            ..RealTimeConfig::default()
        })
    }
}

/// Replaces what an option gives.
fn replace<T>(value: &mut T, given: Option<T>) {
    if let Some(given) = given {
        *value = given;
    }
}
