//! `singletrack demo`: the paper's circle, driven by the daemon on the simulated car, in real time
//! or, where the computer can't keep it, in virtual time.

mod drive;
mod fleet;
mod report;
mod settings;

use std::{path::PathBuf, time::Duration};

use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use singletrack_figures::plot::because;
use singletrack_pilot::{Mode, Reason};
use singletrack_sim::{BoardKind, LossPattern, TimedTruth, Truth};
use singletrackd::Summary;

use crate::{Result, arguments::duration_within, interrupt::Interrupt, progress::progress_bar};
use report::BoardFigures;
use settings::{MAX_CARS, prepare};

/// Options of `singletrack demo`.
#[derive(Clone, Debug, Args)]
pub struct DemoArgs {
    /// How long to drive, such as 40s; a bare number is in seconds
    #[arg(long = "for", value_name = "DURATION", default_value = "40s", value_parser = parse_time)]
    duration: Duration,

    /// The board: its code compiled for this machine, or the Arduino's image on a simulated
    /// processor (`cargo uno` builds it)
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,

    /// The car: the paper's, or one that is made of the logs of a real car (`tools/vehicles`)
    #[arg(long, value_enum, default_value_t = Car::Paper)]
    car: Car,

    /// Several cars on circles that cross, which keep apart, 2 to 20
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_cars)]
    #[arg(conflicts_with_all = ["live", "board", "car", "loss", "feed_forward"])]
    cars: usize,

    /// Where the configuration, the record, the figures and the summary go
    #[arg(long, value_name = "DIR", default_value = "singletrack-demo")]
    out: PathBuf,

    /// Seed of all random numbers of the simulation
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Add the reference's velocity to the position loop, so that the error goes to zero
    #[arg(long)]
    feed_forward: bool,

    /// Serve the drive live to Foxglove, Lichtblick and PlotJuggler on this machine
    /// [default port: 8765]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    live: Option<u16>,

    /// Serve a page that shows the drive in a browser on this machine [default port: 8767]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8767")]
    watch: Option<u16>,

    /// Drive in virtual time, as fast as the computer can, and without lateness
    #[arg(long = "virtual", conflicts_with_all = ["live", "watch"])]
    virtual_time: bool,

    /// Lose the markers for a DURATION at every multiple of an INTERVAL, such as 200ms@2s
    #[arg(long, value_name = "DURATION@INTERVAL")]
    loss: Option<LossPattern>,
}

/// A simulated car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Car {
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

/// Runs the demo.
///
/// # Errors
///
/// Why the car did not drive to the end; the record and the figures so far are
/// written all the same.
pub fn run(args: &DemoArgs) -> Result<()> {
    if args.live.is_some() && !cfg!(feature = "live") {
        let why = "--live needs the feature `live`, without which this program was built: `cargo \
                   demo --live` builds it with it";
        return Err(why.into());
    }
    let interrupt = Interrupt::listen()?;
    let folder = prepare(&args.out)?;
    let millis = u64::try_from(args.duration.as_millis()).unwrap_or(u64::MAX);
    let demo = Demo {
        args,
        interrupt,
        bar: progress_bar(millis, "{bar:10} {percent:>3} %  {msg}"),
    };
    if args.cars > 1 {
        return fleet::run(&demo);
    }
    let driven = if args.virtual_time {
        drive::virtual_time(&demo)?
    } else {
        let driven = drive::real_time(&demo);
        match untimely(args, &driven) {
            Some(reason) if !demo.interrupt.is_raised() => {
                let note = format!(
                    "singletrack: this computer is too busy for real time ({reason}): the demo goes \
                     on in virtual time, which --virtual asks for"
                );
                demo.bar.suspend(|| eprintln!("{note}"));
                settings::clear(&args.out)?;
                drive::virtual_time(&demo)?
            }
            _ => driven?,
        }
    };
    demo.bar.finish_and_clear();
    drop(folder);

    let plotted = report::plot(args, &driven);
    report::write(args, &driven, plotted.is_ok())?;
    if let (Some(_), Err(error)) = (&driven.ended, &plotted) {
        // Why the drive ended matters more, and comes last.
        eprintln!("singletrack: no figures: {error}");
    }
    match driven.ended {
        None => Ok(plotted?),
        Some(_) if demo.interrupt.is_raised() => Err(INTERRUPTED.into()),
        Some(ended) => Err(format!(
            "the drive ended after {:.1} s of {:.1} s: mode {}{}; see {}",
            ended.after_s,
            args.duration.as_secs_f64(),
            ended.mode,
            because(ended.reason),
            args.out.display()
        )
        .into()),
    }
}

/// Why a drive ended or did not begin, if that is what happens on a computer that holds up programs
/// and lines for longer than a command lives. In a drive without lost markers nothing else is wrong.
fn untimely(args: &DemoArgs, driven: &Result<Drive>) -> Option<Reason> {
    let reason = match driven {
        Ok(drive) => drive.ended.as_ref()?.reason?,
        Err(error) => error.downcast_ref::<NotStarted>()?.reason?,
    };
    let by_line = matches!(
        reason,
        Reason::BatteryUnknown
            | Reason::BoardBooting
            | Reason::BoardFailsafe
            | Reason::BoardTimeout
            | Reason::DeadlineMissed
            | Reason::ImuSilent
            | Reason::LinkDown
    );
    let by_cameras = matches!(
        reason,
        Reason::BlindTooFar | Reason::CaptureTimeUncertain | Reason::NoPose | Reason::PoseTooOld
    );
    (by_line || (by_cameras && args.loss.is_none())).then_some(reason)
}

/// A demo under way.
struct Demo<'a> {
    args: &'a DemoArgs,
    interrupt: Interrupt,
    /// It is moved by milliseconds.
    bar: ProgressBar,
}

impl Demo<'_> {
    fn waiting(&self, mode: Mode, reason: Option<Reason>) {
        self.bar.set_message(match reason {
            Some(reason) => format!("{mode}: waiting, {reason}"),
            None => mode.to_string(),
        });
    }

    /// Shows the true car, and its P.
    fn driving(&self, time: f64, truth: &Truth, point: [f64; 2], held: bool) {
        let expected_m = settings::expected(self.args.feed_forward).error_m;
        self.bar.set_position((time * 1000.0) as u64);
        self.bar.set_message(format!(
            // 80 columns wide, with the bar.
            "{time:4.1} s  car at ({:5.2}, {:5.2}) m, P {:5.1} mm off (theory: {:.0}){}",
            truth.x,
            truth.y,
            settings::tracking_error(point, time) * 1000.0,
            expected_m * 1000.0,
            if held { "  (markers lost)" } else { "" }
        ));
    }
}

/// A finished drive, for the report.
#[derive(Debug)]
struct Drive {
    /// How it ended before its time, if it did.
    ended: Option<Ended>,
    /// CLOCK_MONOTONIC, or virtual time, of the first driving tick, in ns.
    start_ns: u64,
    /// How long the car drove, in s.
    duration_s: f64,
    /// From the car's centre of mass to its front axle, in m.
    front_axle_distance_m: f64,
    /// Where the car truly was.
    truth: Vec<TimedTruth>,
    /// What the daemon counted in real time.
    summary: Option<Summary>,
    /// What the image took of its processor.
    board: Option<BoardFigures>,
}

/// A drive that ended before its time.
#[derive(Clone, Copy, Debug)]
struct Ended {
    mode: Mode,
    reason: Option<Reason>,
    after_s: f64,
}

/// The car was never ready, or did not start.
#[derive(Debug, thiserror::Error)]
#[error("the car did not start within {seconds} s: mode {mode}{}", because(*reason))]
struct NotStarted {
    /// The mode that it stayed in.
    mode: Mode,
    /// Why.
    reason: Option<Reason>,
    /// How long it was given.
    seconds: u64,
}

/// Why a demo ended that somebody interrupted.
const INTERRUPTED: &str = "interrupted";
