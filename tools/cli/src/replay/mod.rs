//! `singletrack replay`: runs the pilot on the inputs of a record.
//!
//! With the recorded configuration every output must be the same, bit for bit. With
//! another one, the outputs show what the pilot would have commanded on the same
//! events: the loop is open, since the car of the record does not react.

mod change;
mod source;
mod span;
mod verdict;

use std::{io, path::PathBuf, time::Instant};

use clap::Args;
use singletrack_figures::output::print;
use singletrack_record::{Ending, Entry, Meta, Reader, RecordError, Topic};

pub use change::{Change, ChangeError};
pub use source::SourceError;
pub use verdict::{Deviation, Deviations};

use crate::progress::progress_bar;
use span::Span;

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

/// Why a replay failed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayFailure {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The record does not hold its configuration.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// It can't be replayed to its end.
    #[error("{}: {source}{}", path.display(), so_far(*ticks))]
    Replay {
        /// The record.
        path: PathBuf,
        /// Ticks that were the same.
        ticks: u64,
        /// Why.
        source: singletrack_record::ReplayError,
    },
    /// There is nothing to replay.
    #[error("{}: the record has no ticks", .0.display())]
    Empty(PathBuf),
    /// An output differs.
    #[error("{0}")]
    Differs(Box<str>),
    /// The record was made by another controller.
    #[error(
        "{}: made by controller {recorded}, this is {}: {differ} of {ticks} ticks differ, from \
         {from:.3} s on. An older version of singletrack replays it to the bit.",
        path.display(),
        singletrack_pilot::CONTROLLER
    )]
    OtherController {
        /// The record.
        path: PathBuf,
        /// The number of its controller.
        recorded: String,
        /// Ticks with another output.
        differ: u64,
        /// All of them.
        ticks: u64,
        /// The first of them, s into the record.
        from: f64,
    },
    /// The figure can't be written.
    #[error("can't write {}: {source}; choose another --figure", path.display())]
    Figure {
        /// Where.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Standard output.
    #[error("standard output: {0}")]
    Output(#[from] io::Error),
}

impl ReplayFailure {
    /// The exit status of the program.
    #[must_use]
    pub const fn status(&self) -> u8 {
        match self {
            Self::OtherController { .. } => 4,
            _ => 1,
        }
    }
}

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

/// Replays a record and prints the result.
///
/// # Errors
///
/// What can't be read or replayed; without `--set`, the first output that differs.
pub fn run(args: &ReplayArgs) -> Result<(), ReplayFailure> {
    let start = Instant::now();
    let mut replay = source::pilot(&args.record, &args.set)?;
    let mut ticks = Reader::open(&args.record)?.only(&[Topic::Tick]);
    let meta = ticks.meta().clone();
    let progress = progress_bar(0, "{spinner} {pos} ticks replayed");
    let mut deviations = Deviations::default();
    let mut span = Span::default();
    let foreign = controller(&meta) != singletrack_pilot::CONTROLLER.to_string();
    let is_verified = args.set.is_empty();
    // Ticks that differ, and when the first did.
    let mut differ: (u64, f64) = (0, 0.0);
    for entry in ticks.by_ref() {
        let Entry::Tick(tick) = entry? else { continue };
        let output = replay.tick(&tick).map_err(|source| ReplayFailure::Replay {
            path: args.record.clone(),
            ticks: span.ticks,
            source,
        })?;
        if is_verified && !tick.is_output(&output) {
            if !foreign {
                progress.finish_and_clear();
                return Err(ReplayFailure::Differs(verdict::first_difference(
                    &args.record,
                    &meta,
                    &tick,
                    &output,
                    &span,
                )));
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
        return Err(ReplayFailure::Empty(args.record.clone()));
    }
    if differ.0 > 0 {
        print!("{deviations}");
        return Err(ReplayFailure::OtherController {
            path: args.record.clone(),
            recorded: controller(&meta).to_owned(),
            differ: differ.0,
            ticks: span.ticks,
            from: differ.1,
        });
    }
    let pace = span.pace(start.elapsed());
    let told = if is_verified {
        let log = args.record.display();
        format!(
            "{log}: {} ticks, every output the same to the bit\n",
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
        eprintln!("singletrack: {}: {ending}", args.record.display());
    }
    Ok(print(&format!("{told}{pace}\n"))?)
}

/// Writes the figure, and says where.
fn draw(args: &ReplayArgs, deviations: &Deviations) -> Result<PathBuf, ReplayFailure> {
    let beside = || args.record.with_extension("replay.svg");
    let path = args.figure.clone().unwrap_or_else(beside);
    match std::fs::write(&path, deviations.figure().to_svg()) {
        Ok(()) => Ok(path),
        Err(source) => Err(ReplayFailure::Figure { path, source }),
    }
}
