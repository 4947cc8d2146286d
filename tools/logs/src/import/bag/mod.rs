//! A log in a bag of ROS 2: rosbag2, in MCAP or sqlite files.

mod cdr;
mod definition;
mod files;
mod messages;
mod path;
mod wanted;

use std::{fmt, path::Path};

pub(super) use files::{check, is_bag};

use super::{
    FIRST_ROW_NS,
    columns::Columns,
    log::{ImportError, Log},
    map::Map,
};
use messages::Messages;

/// Reads the bag `path` as `map` says.
pub(super) fn read(path: &Path, map: &Map) -> Result<Log, ImportError> {
    let mut sources = Vec::new();
    let mut columns = Columns::find(&mut sources, map)?;
    let mut messages = Messages::new(path, sources);
    files::read(path, &mut messages)?;
    let sorted = messages.sort(map.time.longest_gap_ns())?;
    let mut span = None;
    for (time_ns, row) in messages.rows() {
        let (first_ns, _) = *span.get_or_insert((time_ns, time_ns));
        span = Some((first_ns, time_ns));
        columns.take(&row, FIRST_ROW_NS.saturating_add(time_ns - first_ns))?;
    }
    let (first_ns, last_ns) = span.unwrap_or_default();
    let end_ns = FIRST_ROW_NS.saturating_add(last_ns - first_ns);
    Ok(columns.log(map, first_ns, end_ns, sorted))
}

/// The error of a file or folder that is no bag, or is damaged; why, and what to do.
fn unreadable(path: &Path, why: impl fmt::Display) -> ImportError {
    let path = path.display();
    ImportError::Invalid(format!("can't read {path} as a bag: {why}"))
}

/// A time in ns, written in seconds with all digits.
fn seconds(ns: u64) -> String {
    format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
}
