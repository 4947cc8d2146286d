//! The results of the demo: a summary, figures, and a few printed lines.

use std::io::{self, Write};

use serde::Serialize;
use singletrack_figures::plot::{
    self, FigureKind, PlotError, REPORT, Record, TruthSample, write_animation, write_figures,
    write_report,
};
use singletrack_pilot::Reason;
use singletrack_scenario::tracking::{Sample, Tracking, last_turn, rms_error};
use singletrack_sim::{LossPattern, Truth};
use singletrackd::{Percentiles, Summary};

use super::{
    arguments::DemoArgs,
    error::DemoError,
    files::BoardFigures,
    files::{self, CONFIGURATION, FIGURES, RECORD, SIMULATION, SUMMARY},
    outcome::Drive,
    settings,
};

/// `summary.json`.
#[derive(Serialize)]
struct DemoSummary<'a> {
    /// Whether the car drove to the end.
    completed: bool,
    /// The mode that it went to instead, and why.
    mode: Option<&'static str>,
    reason: Option<&'static str>,
    duration_s: f64,
    seed: u64,
    feed_forward: bool,
    loss: Option<String>,
    virtual_time: bool,
    #[serde(flatten)]
    real_time: Option<RealTimeFigures<'a>>,
    /// Of the last full turn.
    tracking: Option<Tracking>,
    /// Of the whole drive.
    rms_error_m: Option<f64>,
    /// What theory expects of it.
    expected: settings::Expected,
    /// With `--board uno` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    board: Option<BoardFigures>,
}

/// What is measured in real time only.
#[derive(Serialize)]
struct RealTimeFigures<'a> {
    ticks: u64,
    deadline_misses: u64,
    lateness_us: Percentiles,
    frames: &'a singletrackd::Frames,
    mocap: Mocap<'a>,
    latency_ms: Latency,
    daemon: &'a Summary,
}

impl<'a> RealTimeFigures<'a> {
    fn of(summary: &'a Summary) -> Self {
        let figures = &summary.figures;
        Self {
            ticks: figures.ticks,
            deadline_misses: figures.deadline_misses,
            lateness_us: figures.lateness_us,
            frames: &figures.frames,
            mocap: Mocap {
                lost: figures.mocap.missing_while_driving,
                frames: figures.mocap.frames,
                held_ticks: figures.mocap.held_ticks,
                detail: &figures.mocap,
            },
            latency_ms: Latency {
                capture_to_command: Percentiles {
                    p50: figures.capture_to_command_us.p50 / 1000.0,
                    p99: figures.capture_to_command_us.p99 / 1000.0,
                    max: figures.capture_to_command_us.max / 1000.0,
                },
            },
            daemon: summary,
        }
    }
}

/// The cameras, over the drive.
#[derive(Serialize)]
struct Mocap<'a> {
    /// Frames without a valid pose while the car drove, for any reason.
    lost: u64,
    frames: u64,
    held_ticks: u64,
    detail: &'a singletrackd::MocapFigures,
}

#[derive(Serialize)]
struct Latency {
    /// In ms.
    capture_to_command: Percentiles,
}

/// Writes the summary, and prints it with the path of the report if there is one.
pub(super) fn write(args: &DemoArgs, drive: &Drive, plotted: bool) -> Result<(), DemoError> {
    let samples = samples(drive);
    let tracking = last_turn(&samples, [0.0, 0.0], settings::ANGULAR_VELOCITY);
    let ended = drive.ended.as_ref();
    let summary = DemoSummary {
        completed: ended.is_none(),
        mode: ended.map(|ended| ended.mode.name()),
        reason: ended.and_then(|ended| ended.reason).map(Reason::name),
        duration_s: drive.duration_s,
        seed: args.seed,
        feed_forward: args.feed_forward,
        loss: args.loss.as_ref().map(LossPattern::to_string),
        virtual_time: drive.summary.is_none(),
        real_time: drive.summary.as_ref().map(RealTimeFigures::of),
        tracking,
        rms_error_m: rms_error(&samples),
        expected: settings::expected(args.feed_forward),
        board: drive.board,
    };
    let path = args.out.join(SUMMARY);
    let json = serde_json::to_string_pretty(&summary)
        .map_err(|error| DemoError::Other(format!("can't write {}: {error}", path.display())))?;
    files::write(&path, &format!("{json}\n"))?;
    // A closed pipe is no error.
    let _ = print(&mut io::stdout().lock(), args, drive, &summary, plotted);
    Ok(())
}

/// The true P beside its reference, over the drive.
fn samples(drive: &Drive) -> Vec<Sample> {
    truths(drive, drive.start_ns, drive.duration_s)
        .map(|(time, truth)| Sample {
            time,
            point: settings::point(truth, drive.front_axle_distance_m),
            reference: settings::reference(time),
        })
        .collect()
}

/// The truth from a time on CLOCK_MONOTONIC on, for a duration, each with the time since then.
fn truths(drive: &Drive, start_ns: u64, duration_s: f64) -> impl Iterator<Item = (f64, &Truth)> {
    let timed = drive.truth.iter();
    timed
        .filter(move |timed| timed.monotonic_ns >= start_ns)
        .map(move |timed| ((timed.monotonic_ns - start_ns) as f64 * 1e-9, &timed.truth))
        .take_while(move |(time, _)| *time <= duration_s)
}

/// Writes the figures of the record, with ground truth.
pub(super) fn plot(args: &DemoArgs, driven: &Drive) -> Result<(), PlotError> {
    let mut record = Record::read(&args.out.join(RECORD))?;
    let (number, drive) = record.choose(None)?;
    let truth = true_samples(driven, drive);
    if let Some(drive) = record.recording.drives.get_mut(number - 1) {
        drive.truth = Some(truth);
    }
    let (number, drive) = record.choose(Some(number))?;
    write_figures(drive, &FigureKind::ALL, &args.out.join(FIGURES))?;
    write_report(&record, number, drive, &args.out)?;
    write_animation(&record, drive, &args.out)?;
    Ok(())
}

/// Ground truth while the car drove.
fn true_samples(driven: &Drive, drive: &plot::drive::Drive) -> Vec<TruthSample> {
    truths(driven, drive.start_ns, drive.duration())
        .map(|(time, truth)| TruthSample {
            time,
            point: settings::point(truth, driven.front_axle_distance_m),
            steering: truth.steering,
            speed: truth.speed,
            sideslip: truth.sideslip,
            yaw_rate: truth.yaw_rate,
        })
        .collect()
}

/// The summary, for a person.
fn print(
    out: &mut impl Write,
    args: &DemoArgs,
    drive: &Drive,
    summary: &DemoSummary<'_>,
    plotted: bool,
) -> io::Result<()> {
    let folder = &args.out;
    let expected = &summary.expected;
    writeln!(
        out,
        "Drove {:.1} s of the paper's circle{}.",
        drive.duration_s,
        if summary.virtual_time {
            ", in virtual time"
        } else {
            ""
        }
    )?;
    match &summary.tracking {
        Some(tracking) => writeln!(
            out,
            "  P, last full turn   amplitude {:.3} m, lag {:.3} rad, RMS error {:.1} mm",
            tracking.amplitude_m,
            tracking.lag_rad,
            tracking.rms_error_m * 1000.0
        )?,
        None => writeln!(
            out,
            "  P, from the start   RMS error {:.1} mm; a full turn takes 12.6 s",
            summary.rms_error_m.unwrap_or(f64::NAN) * 1000.0
        )?,
    }
    writeln!(
        out,
        "  theory, settled     amplitude {:.3} m, lag {:.3} rad, RMS error {:.1} mm{}",
        expected.amplitude_m,
        expected.lag_rad,
        expected.error_m * 1000.0,
        if args.feed_forward {
            ""
        } else {
            " (unit gain alone; --feed-forward: 0)"
        }
    )?;
    if let Some(Summary { figures, .. }) = &drive.summary {
        writeln!(
            out,
            "  ticks               {}, {} deadlines missed; {:.0} us late at the median, {:.0} us at p99",
            figures.ticks,
            figures.deadline_misses,
            figures.lateness_us.p50,
            figures.lateness_us.p99
        )?;
        writeln!(
            out,
            "  capture to command  {:.1} ms at the median, {:.1} ms at p99",
            figures.capture_to_command_us.p50 / 1000.0,
            figures.capture_to_command_us.p99 / 1000.0
        )?;
        writeln!(
            out,
            "  cameras             {} frames, {} without a pose while driving, {} ticks held",
            figures.mocap.frames, figures.mocap.missing_while_driving, figures.mocap.held_ticks
        )?;
        writeln!(
            out,
            "  line                {} frames out, {} in, {} damaged",
            figures.frames.sent,
            figures.frames.received,
            figures.frames.crc_errors + figures.frames.decode_errors
        )?;
    }
    if let Some(board) = &drive.board {
        writeln!(
            out,
            "  board               {} B of flash, {} B of SRAM, {:.1} % busy, longest interrupt {} cycles, pulse jitter {:.3} us",
            board.flash_bytes,
            board.sram_bytes,
            board.cpu_percent,
            board.isr_max_cycles,
            board.pulse_jitter_us
        )?;
    }
    writeln!(
        out,
        "In {}: {FIGURES}/, {SUMMARY}, {RECORD}, {CONFIGURATION}, {SIMULATION}",
        folder.display()
    )?;
    if plotted {
        writeln!(out, "Open {}", folder.join(REPORT).display())?;
    }
    Ok(())
}
