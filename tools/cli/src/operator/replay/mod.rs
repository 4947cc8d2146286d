//! `singletrack replay`: runs the pilot on the inputs of a record.
//!
//! With the recorded configuration every output must be the same, bit for bit. With
//! another one, the outputs show what the pilot would have commanded on the same
//! events: the loop is open, since the car of the record does not react.

mod change;
mod source;
mod verdict;

use std::{error::Error, path::PathBuf, process::ExitCode, time::Instant};

use clap::Args;
use singletrack_figures::output::print;
use singletrack_record::{Ending, Entry, Meta, Reader, Topic};

pub use change::Change;
pub use verdict::{Deviation, Deviations};

use crate::{help::printable, progress::progress_bar};
use source::Span;

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
pub fn run(args: &ReplayArgs) -> Result<ExitCode, Box<dyn Error>> {
    let start = Instant::now();
    let mut replay = source::pilot(&args.record, &args.set)?;
    let mut ticks = Reader::open(&args.record)?.only(&[Topic::Tick]);
    let meta = ticks.meta().clone();
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
                return Err(verdict::first_difference(path, &meta, &tick, &output, &span).into());
            }
            if differ.0 == 0 {
                differ.1 = span.seconds_to(&tick);
            }
            differ.0 += 1;
        }
        if foreign || !is_verified {
            deviations.add(&tick, &output);
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
        format!(
            "{record}: {} ticks, every output the same to the bit\n",
            span.ticks
        )
    } else {
        let figure = draw(args, &deviations)?;
        format!(
            "{deviations}{}: recorded and replayed commands\n",
            figure.display()
        )
    };
    if let Some(ending @ Ending::Unfinished { .. }) = ticks.ending() {
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
