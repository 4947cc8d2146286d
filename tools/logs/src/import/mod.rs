//! Import of a log of another program as a record.
//!
//! The log is a bag of ROS 2, or one or several CSV files on one clock. A [map](Map) says which columns it has, or topics and
//! fields, and what they mean. The result has the poses as the motion capture saw them, and a tick every
//! `tick_ms` with the events that a pilot would have been given: poses when they arrived, and samples of
//! the board.
//!
//! **Clock.** The first row of the log is at [`FIRST_ROW_NS`] on the monotonic clock of the
//! record. Everything else is relative to it.
//!
//! **Delays are removed.** A sensor's samples are in the record at the time at which they were
//! measured: the time of the row less the `delay_s` of the sensor. The commands are in force from
//! the time of their row less their `delay_s`. A pose arrives with its row and was captured its
//! `delay_s` before.
//!
//! **Nothing is guessed.** A sensor without a column has no samples. What can't be read is an
//! error with its line and column, or with its topic and the number of the message.

mod bag;
mod columns;
mod csv_log;
mod log;
mod map;
mod timeline;

use std::{collections::BTreeMap, fs, path::Path};

use singletrack_record::{ClockMapping, Entry, Meta, Recorder, part_path};

pub use log::{ImportError, Summary, Times};
pub use map::{
    Acceleration, Angle, AngularVelocity, CommandSection, Dimension, DrivingSection, EmptyRows,
    ImuSection, Length, Map, MotorSection, PoseSection, Quantity, Speed, SteeringSection,
    TimeSection, TimeUnit,
};

use log::Log;
use timeline::Timeline;

/// The time of the first row on the monotonic clock of the record, in ns: later than the longest
/// delay of a sensor.
pub const FIRST_ROW_NS: u64 = 1_000_000_000;

/// The name of the software in the metadata of a record.
pub const SOFTWARE: &str = "singletrack-import";

/// Makes the record `out` of `logs`, as the map in the file `map` says. A folder is a bag, and so is a file
/// that ends in `.mcap` or `.db3`; any other file is a CSV file. Only of these there can be several.
///
/// The same log and the same map give the same bytes. `progress` gets the number of ticks that
/// are written, and that of all.
///
/// # Errors
///
/// The map or the log can't be read or contradict each other; `out` exists or can't be written.
/// No file is left then.
pub fn import(
    logs: &[impl AsRef<Path>],
    map: &Path,
    out: &Path,
    progress: impl FnMut(u64, u64),
) -> Result<Summary, ImportError> {
    let logs: Vec<&Path> = logs.iter().map(AsRef::as_ref).collect();
    let contents = read(&logs, map)?;
    let names: Vec<String> = logs.iter().map(|log| name(log)).collect();
    let meta = Meta {
        configuration: format!(
            "# Imported by singletrack import {} from {} with {}: no configuration\n",
            env!("CARGO_PKG_VERSION"),
            names.join(" and "),
            name(map)
        ),
        software: BTreeMap::from([(SOFTWARE.to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        protocol_version: singletrack_protocol::VERSION,
        seed: None,
        start: ClockMapping {
            monotonic_ns: FIRST_ROW_NS,
            wall_ns: contents.start_wall_ns,
        },
    };
    let recorder = Recorder::create(out, &meta)?.without_timed_flushes();
    let first = logs.first().copied().unwrap_or(out);
    let result = write(recorder, &contents, first, progress);
    // The error that matters is the first one.
    result.inspect_err(|_| drop(fs::remove_file(part_path(out))))
}

fn read(logs: &[&Path], map: &Path) -> Result<Log, ImportError> {
    let bag = logs.iter().find(|log| bag::is_bag(log));
    if let Some(bag) = bag {
        bag::check(bag)?;
        if logs.len() > 1 {
            let why = " is a bag, and only CSV files can be several: import it alone; the folder of a bag is \
                       all of its files";
            return Err(ImportError::file(bag, why));
        }
    }
    let contents = Map::read(map)?;
    contents.check_kind(bag.is_some(), map)?;
    match bag {
        Some(bag) => bag::read(bag, &contents),
        None => csv_log::read(logs, &contents),
    }
}

fn write(
    mut recorder: Recorder,
    contents: &Log,
    path: &Path,
    mut progress: impl FnMut(u64, u64),
) -> Result<Summary, ImportError> {
    let mut timeline = Timeline::new(contents);
    let ticks = timeline.ticks;
    let failed = |why| ImportError::file(path, format!(": {why}"));
    while let Some(tick) = timeline.next_tick().map_err(failed)? {
        for observation in timeline.arrived() {
            recorder.write(&Entry::Pose(*observation))?;
        }
        let index = tick.index;
        recorder.write(&Entry::Tick(tick))?;
        progress(index + 1, ticks);
    }
    let summary = timeline.summary();
    recorder.finish()?;
    Ok(summary)
}

/// The name of a file without its folder, which must not change the record, on one line.
fn name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().replace(char::is_control, "?")
}
