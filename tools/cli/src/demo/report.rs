//! The results of the demo: a summary, figures, and a few printed lines.

use serde::Serialize;
use singletrack_figures::{
    figure::Figure,
    output,
    plot::{
        self, FigureKind, PlotError, REPORT, Record, TruthSample, write_animation, write_figures,
        write_report,
    },
};
use singletrack_pilot::Reason;
use singletrack_scenario::tracking::{Sample, Tracking, last_turn, rms_error};
use singletrack_sim::{ImageSize, Installation, LossPattern, SimulatedBoard, Truth};
use singletrackd::Summary;

use super::{
    DemoArgs, Drive,
    settings::{self, CONFIGURATION, FIGURES, RECORD, SIMULATION, SUMMARY},
};
use crate::Result;

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
    /// What is measured in real time only.
    #[serde(flatten)]
    daemon: Option<&'a Summary>,
    /// Errors of the last full turn.
    tracking: Option<Tracking>,
    /// Root mean square of the error in the whole drive.
    rms_error_m: Option<f64>,
    /// What theory expects of it.
    expected: settings::Expected,
    /// With `--board uno` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    board: Option<BoardFigures>,
}

/// The UNO image's use of its processor, from power-on to the end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct BoardFigures {
    /// Use of the 32,256 B beside the bootloader.
    pub(super) flash_bytes: u64,
    /// Variables and the deepest stack, of 2,048 B.
    pub(super) sram_bytes: u64,
    /// Time not asleep.
    pub(super) cpu_percent: f64,
    /// The longest interrupt, in cycles of 62.5 ns.
    pub(super) isr_max_cycles: u32,
    /// The largest deviation of a pulse from 20 ms after the one before.
    pub(super) pulse_jitter_us: f64,
}

impl BoardFigures {
    /// None for a board that is not a UNO.
    pub(super) fn of(board: &mut SimulatedBoard) -> Result<Option<Self>, String> {
        if let Some(failure) = board.failure() {
            return Err(format!("the board: {failure}"));
        }
        let (Some(figures), Some(pulse_jitter_us)) = (board.figures(), board.pulse_jitter_us())
        else {
            return Ok(None);
        };
        let size = Installation::find()
            .and_then(|installation| ImageSize::read(&installation.image))
            .map_err(|error| format!("the board: {error}"))?;
        let asleep = figures.cycles_asleep as f64 / figures.cycles.max(1) as f64;
        let longest = figures.interrupts.iter().map(|one| one.most_cycles).max();
        Ok(Some(Self {
            flash_bytes: size.flash_bytes,
            sram_bytes: size.static_bytes + u64::from(figures.stack_bytes),
            cpu_percent: 100.0 * (1.0 - asleep),
            isr_max_cycles: longest.unwrap_or(0),
            pulse_jitter_us,
        }))
    }
}

/// Writes the summary, and prints it with the path of the report if there is one.
pub(super) fn write(args: &DemoArgs, drive: &Drive, plotted: bool) -> Result<()> {
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
        daemon: drive.summary.as_ref(),
        tracking,
        rms_error_m: rms_error(&samples),
        expected: settings::expected(args.feed_forward),
        board: drive.board,
    };
    let path = args.out.join(SUMMARY);
    let json = serde_json::to_string_pretty(&summary)
        .map_err(|error| format!("can't write {}: {error}", path.display()))?;
    output::write(&path, &format!("{json}\n"))?;
    let mut text = text(args, drive, &summary);
    if plotted {
        text += &format!("Open {}\n", args.out.join(REPORT).display());
    }
    Ok(output::print(&text)?)
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
        drive.truth = truth;
    }
    let (number, drive) = record.choose(Some(number))?;
    let (figures, _) = plot::draw(drive, FigureKind::ALL);
    write_figures(&figures, &args.out.join(FIGURES), Figure::to_svg)?;
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
fn text(args: &DemoArgs, drive: &Drive, summary: &DemoSummary<'_>) -> String {
    let note = summary.virtual_time.then_some(", in virtual time");
    let (time_s, note) = (drive.duration_s, note.unwrap_or_default());
    let mut lines = vec![format!("Drove {time_s:.1} s of the paper's circle{note}.")];
    let mut line = |name: &str, text: String| lines.push(format!("  {name:<20}{text}"));
    match summary.tracking {
        Some(turn) => {
            let driven = circle(turn.amplitude_m, turn.lag_rad, turn.rms_error_m);
            line("P, last full turn", driven);
        }
        None => {
            let error_mm = summary.rms_error_m.unwrap_or(f64::NAN) * 1000.0;
            let error = format!("RMS error {error_mm:.1} mm; a full turn takes 12.6 s");
            line("P, from the start", error);
        }
    }
    let expected = &summary.expected;
    let note = (!args.feed_forward).then_some(" (unit gain alone; --feed-forward: 0)");
    let theory = circle(expected.amplitude_m, expected.lag_rad, expected.error_m);
    line("theory, settled", theory + note.unwrap_or_default());
    if let Some(Summary { figures, .. }) = summary.daemon {
        let (late, latency) = (figures.lateness_us, figures.capture_to_command_us);
        let (mocap, frames) = (figures.mocap, figures.frames);
        let ticks = format!(
            "{}, {} deadlines missed; {:.0} us late at the median, {:.0} us at p99",
            figures.ticks, figures.deadline_misses, late.p50, late.p99
        );
        line("ticks", ticks);
        let [median, p99] = [latency.p50, latency.p99].map(|us| us / 1000.0);
        let latency = format!("{median:.1} ms at the median, {p99:.1} ms at p99");
        line("capture to command", latency);
        let cameras = format!(
            "{} frames, {} without a pose while driving, {} ticks held",
            mocap.frames, mocap.missing_while_driving, mocap.held_ticks
        );
        line("cameras", cameras);
        let damaged = frames.crc_errors + frames.decode_errors;
        let (sent, received) = (frames.sent, frames.received);
        let frames = format!("{sent} frames out, {received} in, {damaged} damaged");
        line("line", frames);
    }
    if let Some(board) = summary.board {
        let board = format!(
            "{} B of flash, {} B of SRAM, {:.1} % busy, longest interrupt {} cycles, \
             pulse jitter {:.3} us",
            board.flash_bytes,
            board.sram_bytes,
            board.cpu_percent,
            board.isr_max_cycles,
            board.pulse_jitter_us
        );
        line("board", board);
    }
    lines.push(format!(
        "In {}: {FIGURES}/, {SUMMARY}, {RECORD}, {CONFIGURATION}, {SIMULATION}\n",
        args.out.display()
    ));
    lines.join("\n")
}

/// A point on a circle, in words.
fn circle(amplitude_m: f64, lag_rad: f64, error_m: f64) -> String {
    let error_mm = error_m * 1000.0;
    format!("amplitude {amplitude_m:.3} m, lag {lag_rad:.3} rad, RMS error {error_mm:.1} mm")
}
