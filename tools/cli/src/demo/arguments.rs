//! Options of `singletrack demo`.

use std::{path::PathBuf, time::Duration};

use clap::{Args, ValueEnum};
use singletrack_sim::{BoardKind, LossPattern};

use super::files::MAX_CARS;
use crate::arguments::duration_within;

/// Options of `singletrack demo`.
#[derive(Clone, Debug, Args)]
pub struct DemoArgs {
    /// How long to drive, such as 40s; a bare number is in seconds
    #[arg(long = "for", value_name = "DURATION", default_value = "40s", value_parser = parse_time)]
    pub(super) duration: Duration,

    /// The board: its code compiled for this machine, or the Arduino's image on a simulated
    /// processor (`cargo uno` builds it)
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    pub(super) board: BoardKind,

    /// The car: the paper's, or one that is made of the logs of a real car (`tools/vehicles`)
    #[arg(long, value_enum, default_value_t = Car::Paper)]
    pub(super) car: Car,

    /// Several cars on circles that cross, which keep apart, 2 to 20
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_cars)]
    #[arg(conflicts_with_all = ["live", "board", "car", "loss", "feed_forward"])]
    pub(super) cars: usize,

    /// Where the configuration, the record, the figures and the summary go
    #[arg(long, value_name = "DIR", default_value = "singletrack-demo")]
    pub(super) out: PathBuf,

    /// Seed of all random numbers of the simulation
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,

    /// Add the reference's velocity to the position loop, so that the error goes to zero
    #[arg(long)]
    pub(super) feed_forward: bool,

    /// Serve the drive live to Foxglove, Lichtblick and PlotJuggler on this machine
    /// [default port: 8765]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    pub(super) live: Option<u16>,

    /// Serve a page that shows the drive in a browser on this machine [default port: 8767]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8767")]
    pub(super) watch: Option<u16>,

    /// Drive in virtual time, as fast as the computer can, and without lateness
    #[arg(long = "virtual", conflicts_with_all = ["live", "watch"])]
    pub(super) virtual_time: bool,

    /// Lose the markers for a DURATION at every multiple of an INTERVAL, such as 200ms@2s
    #[arg(long, value_name = "DURATION@INTERVAL")]
    pub(super) loss: Option<LossPattern>,
}

/// A simulated car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum Car {
    /// The paper's, 1:10.
    #[default]
    Paper,
    /// DART, about 1:18: its tyres, play in the steering, and an IMU that vibrates.
    Dart,
    /// An F1TENTH of Poznan University of Technology, 1:10: twice as heavy, and with grip.
    Put,
}

fn parse_cars(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(cars) if (1..=MAX_CARS).contains(&cars) => Ok(cars),
        _ => Err(format!("{text} is not between 1 and {MAX_CARS}")),
    }
}

fn parse_time(text: &str) -> Result<Duration, String> {
    duration_within(text, 0.1, 86_400.0)
}
