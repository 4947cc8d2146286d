//! `singletrack replay`: runs the pilot on the inputs of a record.
//!
//! With the recorded configuration every output must be the same, bit for bit. With
//! another one, the outputs show what the pilot would have commanded on the same
//! events: the loop is open, since the car of the record does not react.

use std::{
    fmt::{self, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
    str::FromStr,
    time::{Duration, Instant},
};

use clap::Args;
use singletrack_control::statistics::RootMeanSquare;
use singletrack_core::{Config, ConfigError};
use singletrack_figures::{
    figure::{Axis, Column, Curve, Figure, Look, Panel, Symbol},
    output::print,
};
use singletrack_logs::import;
use singletrack_pilot::{Mode, Output, PilotConfig, Reason};
use singletrack_record::{Ending, Entry, Meta, Reader, Replay, TickRecord, Topic};
use toml::{Table, Value};

use crate::{Result, help::printable, progress::progress_bar};

/// Options of `singletrack replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// A record (*.mcap, or *.mcap.part).
    pub record: PathBuf,

    /// Compare every output bit for bit, and fail at the first difference [default
    /// without --set].
    #[arg(long, conflicts_with = "set")]
    pub verify: bool,

    /// Replay with another configuration, such as `law.point_distance_m=0.4`, and
    /// print how the outputs deviate. May be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<Change>,

    /// Where the figure of recorded and replayed commands goes, with --set [default:
    /// RECORD.replay.svg].
    #[arg(long, value_name = "FILE.svg", requires = "set", value_parser = svg)]
    pub figure: Option<PathBuf>,
}

/// A name that no record has: the figure overwrites its file.
fn svg(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    match path.extension() {
        Some(extension) if extension == "svg" => Ok(path),
        _ => Err("it is an SVG: give it a name that ends with .svg".to_owned()),
    }
}

/// The exit status of the replay of a record that another controller made, whose outputs differ.
const OTHER_CONTROLLER: u8 = 4;

/// The number of the controller that made a record.
fn controller(meta: &Meta) -> &str {
    meta.software.get("controller").map_or("1", String::as_str)
}

fn so_far(ticks: u64) -> String {
    match ticks {
        0 => String::new(),
        ticks => format!(" ({ticks} ticks before that are the same)"),
    }
}

/// Replays a record and prints the result. The status is 4 if another controller made the record, and
/// its outputs differ.
///
/// # Errors
///
/// What can't be read or replayed; without `--set`, the first output that differs.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let start = Instant::now();
    let mut replay = pilot(&args.record, &args.set)?;
    let mut ticks = Reader::open(&args.record)?.only(&[Topic::Tick]);
    let meta = ticks.meta.clone();
    let record = args.record.display();
    let progress = progress_bar(0, "{spinner} {pos} ticks replayed");
    let mut deviations = Deviations::default();
    let mut span = Span::default();
    let foreign = controller(&meta) != singletrack_pilot::CONTROLLER.to_string();
    let is_verified = args.set.is_empty();
    // Ticks that differ, and when the first did.
    let mut differ: (u64, f64) = (0, 0.0);
    for entry in ticks.by_ref() {
        let Entry::Tick(tick) = entry? else { continue };
        let output = replay
            .tick(&tick)
            .map_err(|error| format!("{record}: {error}{}", so_far(span.ticks)))?;
        if is_verified && !tick.is_output(&output) {
            if !foreign {
                progress.finish_and_clear();
                let path = &args.record;
                return Err(first_difference(path, &meta, &tick, &output, &span).into());
            }
            if differ.0 == 0 {
                differ.1 = span.seconds_to(&tick);
            }
            differ.0 += 1;
        }
        if foreign || !is_verified {
            deviations.add(span.seconds_to(&tick), &tick, &output);
        }
        span.add(&tick);
        if span.ticks.is_multiple_of(1_000) {
            progress.set_position(span.ticks);
        }
    }
    progress.finish_and_clear();
    if span.ticks == 0 {
        return Err(format!("{record}: the record has no ticks").into());
    }
    if differ.0 > 0 {
        print!("{deviations}");
        let (recorded, ours) = (controller(&meta), singletrack_pilot::CONTROLLER);
        let ((differ, from), ticks) = (differ, span.ticks);
        let text = format!(
            "{record}: made by controller {recorded}, this is {ours}: {differ} of {ticks} ticks differ, \
             from {from:.3} s on. An older version of singletrack replays it to the bit."
        );
        eprintln!("singletrack: {}", printable(&text));
        return Ok(ExitCode::from(OTHER_CONTROLLER));
    }
    let pace = span.pace(start.elapsed());
    let told = if is_verified {
        let ticks = span.ticks;
        format!("{record}: {ticks} ticks, every output the same to the bit\n")
    } else {
        let path = draw(args, &deviations)?;
        let figure = path.display();
        format!("{deviations}{figure}: recorded and replayed commands\n")
    };
    if let Some(ending @ Ending::Unfinished { .. }) = ticks.ending {
        eprintln!("singletrack: {record}: {ending}");
    }
    print(&format!("{told}{pace}\n")).map_err(|error| format!("standard output: {error}"))?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the figure, and says where.
fn draw(args: &ReplayArgs, deviations: &Deviations) -> Result<PathBuf, String> {
    let beside = || args.record.with_extension("replay.svg");
    let path = args.figure.clone().unwrap_or_else(beside);
    match std::fs::write(&path, deviations.figure().to_svg()) {
        Ok(()) => Ok(path),
        Err(error) => {
            let path = path.display();
            Err(format!(
                "can't write {path}: {error}; choose another --figure"
            ))
        }
    }
}

/// A key of the configuration, and what it is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    key: Vec<String>,
    value: Value,
}

impl FromStr for Change {
    type Err = String;

    /// A value is written as in the configuration; words need no quotation marks.
    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| {
            format!("{text:?}: write KEY=VALUE, such as law.point_distance_m=0.4")
        })?;
        let key: Vec<_> = key.split('.').map(|part| part.trim().to_owned()).collect();
        if key.iter().any(String::is_empty) {
            let key = key.join(".");
            return Err(format!(
                "{key:?} is no key: write it as law.point_distance_m"
            ));
        }
        let word = || Value::String(value.trim().to_owned());
        let value = value.trim().parse().unwrap_or_else(|_| word());
        Ok(Self { key, value })
    }
}

impl fmt::Display for Change {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}={}", self.key.join("."), self.value)
    }
}

/// The configuration `toml` with changes.
fn apply(toml: &str, changes: &[Change]) -> Result<String, String> {
    let of_record = |error: &dyn fmt::Display| format!("the configuration in the record: {error}");
    let mut table: Table = toml::from_str(toml).map_err(|error| of_record(&error))?;
    for change in changes {
        let Some((last, sections)) = change.key.split_last() else {
            continue;
        };
        let mut place = &mut table;
        for section in sections {
            let inner = place
                .entry(section.clone())
                .or_insert_with(|| Value::Table(Table::new()));
            place = match inner {
                Value::Table(table) => table,
                other => {
                    let key = change.key.join(".");
                    return Err(format!("{key}: {section} is no section but {other}"));
                }
            };
        }
        let value = match (place.get(last), &change.value) {
            // As people write it: 1 for 1.0.
            (Some(Value::Float(_)), Value::Integer(number)) => Value::Float(*number as f64),
            (_, value) => value.clone(),
        };
        place.insert(last.clone(), value);
    }
    toml::to_string(&table).map_err(|error| of_record(&error))
}

/// What has been replayed.
#[derive(Clone, Copy, Debug, Default)]
struct Span {
    ticks: u64,
    first_ns: Option<u64>,
    last_ns: u64,
}

impl Span {
    fn add(&mut self, tick: &TickRecord) {
        self.first_ns.get_or_insert(tick.start_ns);
        self.ticks += 1;
        self.last_ns = tick.start_ns;
    }

    /// From its beginning to `tick`, in s.
    fn seconds_to(&self, tick: &TickRecord) -> f64 {
        let first_ns = self.first_ns.unwrap_or(tick.start_ns);
        tick.start_ns.saturating_sub(first_ns) as f64 * 1e-9
    }

    fn pace(&self, took: Duration) -> String {
        let first_ns = self.first_ns.unwrap_or_default();
        let seconds = self.last_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let took = took.as_secs_f64();
        let pace = seconds / took;
        format!("{seconds:.2} s replayed in {took:.3} s: {pace:.0} times real time")
    }
}

/// A pilot with the configurations of a record, all of them changed by `changes`.
fn pilot(path: &Path, changes: &[Change]) -> Result<Replay> {
    let mut reader = Reader::open(path)?.only(&[Topic::Configuration]);
    if reader.meta.software.contains_key(import::SOFTWARE) {
        let path = path.display();
        return Err(format!(
            "{path} was imported from the log of another program: no pilot made it, so there is \
             nothing to repeat"
        )
        .into());
    }
    let start = reader.meta.configuration.clone();
    let mut replay = Replay::new(configuration(path, 1, &start, changes)?);
    // Nearly no record has another one.
    if reader.message_count(Topic::Configuration) == Some(0) {
        return Ok(replay);
    }
    for entry in reader.by_ref() {
        if let Entry::Configuration(record) = entry? {
            let number = record.number;
            let pilot = configuration(path, number, &record.toml, changes)?;
            replay.configuration(number, pilot);
        }
    }
    Ok(replay)
}

fn configuration(path: &Path, number: u32, toml: &str, changes: &[Change]) -> Result<PilotConfig> {
    let read = |toml: &str| -> Result<(PilotConfig, Config), ConfigError> {
        let config = Config::from_toml(toml)?;
        Ok((config.pilot()?, config))
    };
    // Whose fault it is shows when it is tried without the changes.
    let configuration = format!("configuration {number} of {}", path.display());
    let recorded = read(toml).map_err(|error| {
        format!("{configuration} is not one that this version of singletrack takes: {error}")
    });
    if changes.is_empty() {
        return Ok(recorded?.0);
    }
    let applied = apply(toml, changes).map_err(|error| format!("--set {error}"))?;
    let changed = match read(&applied) {
        Ok(changed) => changed,
        Err(error) => {
            recorded?;
            return Err(format!("with --set, {configuration}: {error}").into());
        }
    };
    if recorded.is_ok_and(|(pilot, config)| changed.0 == pilot && changed.1 != config) {
        let changes: Vec<_> = changes.iter().map(Change::to_string).collect();
        let changes = changes.join(" --set ");
        return Err(format!(
            "--set {changes}: the pilot reads nothing of that; a replay shows what changes in its \
             sections, such as law, outer_loop, reference, limits, estimator, supervisor, watch and \
             fence"
        )
        .into());
    }
    Ok(changed.0)
}

/// Who makes records, as they name it.
const DAEMON: &str = "singletrackd";

/// The version of everything here.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Differences that are printed one by one; of more, their number.
const TOLD: usize = 12;

/// The first tick whose output is not the one recorded, with all its inputs.
fn first_difference(
    path: &Path,
    meta: &Meta,
    tick: &TickRecord,
    output: &Output,
    before: &Span,
) -> String {
    let differences = tick.differences(output);
    let mut text = format!(
        "{}: tick {}, {:.3} s into the record, differs; {} ticks before it are the same",
        path.display(),
        tick.index,
        before.seconds_to(tick),
        before.ticks,
    );
    // Writing to a string does not fail.
    for difference in differences.iter().take(TOLD) {
        let _ = write!(text, "\n    {difference}");
    }
    if let Some(more) = differences.len().checked_sub(TOLD).filter(|more| *more > 0) {
        let _ = write!(text, "\n    and {more} fields more");
    }
    let _ = write!(text, "\nThe pilot was told, at {} ns:", tick.pilot_time.0);
    if tick.events.is_empty() {
        text.push_str(" nothing");
    }
    for event in &tick.events {
        let _ = write!(text, "\n    {event:?}");
    }
    let mut json = String::new();
    Entry::Tick(tick.clone()).write_json(&mut json);
    let _ = write!(text, "\nAs recorded:\n{json}");
    let made_by = meta.software.get(DAEMON);
    let made_by = made_by.map_or("no version", String::as_str);
    if made_by != VERSION {
        let _ = write!(
            text,
            "\nThe record was made by {DAEMON} {made_by}, this is {VERSION}: another pilot may \
             decide otherwise."
        );
    }
    text
}

/// What is compared: its name, and where it is found in an output.
type Quantity = (&'static str, &'static str, fn(&Output) -> Option<f64>);

const QUANTITIES: [Quantity; 9] = [
    ("speed", "m/s", |output| Some(output.actuation.speed)),
    ("steering", "rad", |output| Some(output.actuation.steering)),
    ("v_Px", "m/s", |output| Some(output.point_velocity?.x)),
    ("v_Py", "m/s", |output| Some(output.point_velocity?.y)),
    ("estimate x", "m", |output| {
        Some(output.estimate?.position.x)
    }),
    ("estimate y", "m", |output| {
        Some(output.estimate?.position.y)
    }),
    ("estimate yaw", "rad", |output| Some(output.estimate?.yaw)),
    ("estimate yaw rate", "rad/s", |output| {
        Some(output.estimate?.yaw_rate)
    }),
    ("estimate sideslip", "rad", |output| {
        Some(output.estimate?.sideslip)
    }),
];

/// How one quantity deviates over a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Deviation {
    /// Replayed minus recorded, in the ticks in which both have it.
    differences: RootMeanSquare,
    /// Ticks in which one has it.
    unmatched: u64,
    /// The largest of them, by amount.
    largest: f64,
    /// When that was, in s from the first tick.
    largest_at: f64,
}

impl Deviation {
    fn add(&mut self, time: f64, recorded: Option<f64>, replayed: Option<f64>) {
        match (recorded, replayed) {
            (Some(recorded), Some(replayed)) => {
                let deviation = replayed - recorded;
                self.differences.add(deviation);
                if deviation.abs() > self.largest.abs() {
                    (self.largest, self.largest_at) = (deviation, time);
                }
            }
            (None, None) => {}
            _ => self.unmatched += 1,
        }
    }
}

/// How the outputs of a pilot with another configuration deviate.
#[derive(Clone, Debug, Default)]
struct Deviations {
    quantities: [Deviation; QUANTITIES.len()],
    modes: u64,
    first_mode: Option<(f64, Standing, Standing)>,
    /// Time, then speed and steering as recorded and as replayed.
    series: Vec<[f64; 5]>,
}

type Standing = (Mode, Option<Reason>);

impl Deviations {
    /// Takes in a tick, at this time in s since the first.
    fn add(&mut self, time: f64, tick: &TickRecord, output: &Output) {
        for ((_, _, quantity), deviation) in QUANTITIES.iter().zip(&mut self.quantities) {
            deviation.add(time, quantity(&tick.output), quantity(output));
        }
        let standing = |output: &Output| (output.mode, output.reason);
        if tick.output.mode != output.mode {
            self.modes += 1;
            self.first_mode
                .get_or_insert((time, standing(&tick.output), standing(output)));
        }
        let (was, is) = (tick.output.actuation, output.actuation);
        let row = [time, was.speed, is.speed, was.steering, is.steering];
        self.series.push(row);
    }

    /// Speed and steering, replayed over recorded.
    fn figure(&self) -> Figure {
        let column =
            |index: usize| -> Column { self.series.iter().map(|row| row[index]).collect() };
        let time = column(0);
        let panel = |axis: Axis, recorded: usize| {
            let curve = |name, look, index| Curve::new(name, look, &time, column(index));
            Panel {
                curves: vec![
                    curve("recorded", Look::Nominal, recorded),
                    curve("replayed", Look::Actual, recorded + 1),
                ],
                ..Panel::new(
                    Axis::new("time in the record", Some(Symbol::new("t", "")), "s"),
                    axis,
                )
            }
        };
        Figure::page(
            "Commands, recorded and replayed",
            "What the pilot commanded, and what it would have commanded at the sight of \
             the same events with another configuration.",
            vec![
                panel(Axis::new("speed", Some(Symbol::new("v", "")), "m/s"), 1),
                panel(Axis::new("steering", Some(Symbol::new("δ", "")), "rad"), 3),
            ],
        )
    }
}

impl fmt::Display for Deviations {
    /// A table for a person.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "replayed minus recorded, at the sight of the same events (the car of the record \
             goes its way):"
        )?;
        writeln!(
            out,
            "{:<20} {:>6} {:>12} {:>12} {:>9} {:>10}",
            "", "unit", "rms", "largest", "at s", "one alone"
        )?;
        for ((name, unit, _), deviation) in QUANTITIES.iter().zip(&self.quantities) {
            writeln!(
                out,
                "{name:<20} {unit:>6} {:>12.6} {:>12.6} {:>9.2} {:>10}",
                deviation.differences.value().unwrap_or(0.0),
                deviation.largest,
                deviation.largest_at,
                deviation.unmatched
            )?;
        }
        let told = |(mode, reason): Standing| match reason {
            Some(reason) => format!("{mode} ({reason})"),
            None => mode.to_string(),
        };
        match self.first_mode {
            None => writeln!(out, "the mode is the same in every tick"),
            Some((time, recorded, replayed)) => writeln!(
                out,
                "the mode differs in {} ticks, first at {time:.2} s: recorded {}, replayed {}",
                self.modes,
                told(recorded),
                told(replayed)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOML: &str = "[law]\npoint_distance_m = 0.35\n[estimator]\nmarker_loss = \"hold\"\n";

    fn changed(changes: &[&str]) -> Result<String, String> {
        let changes: Result<Vec<Change>, _> = changes.iter().map(|text| text.parse()).collect();
        apply(TOML, &changes?)
    }

    #[test]
    fn numbers_and_words_are_set_and_keys_added() {
        let text = changed(&[
            "law.point_distance_m=1",
            "estimator.marker_loss = coast",
            "supervisor.hold_ms=500",
            "fence.corners_m=[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]",
        ])
        .unwrap();
        let table: Table = toml::from_str(&text).unwrap();
        assert_eq!(table["law"]["point_distance_m"], Value::Float(1.0));
        assert_eq!(table["estimator"]["marker_loss"].as_str(), Some("coast"));
        assert_eq!(table["supervisor"]["hold_ms"].as_integer(), Some(500));
        assert_eq!(table["fence"]["corners_m"].as_array().unwrap().len(), 3);
    }

    #[test]
    fn what_is_no_change_is_refused_by_name() {
        for (text, part) in [
            ("law.point_distance_m", "KEY=VALUE"),
            ("law..x=1", "law..x"),
            ("=1", "no key"),
            ("law.point_distance_m.x=1", "no section but 0.35"),
        ] {
            let error = changed(&[text]).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
