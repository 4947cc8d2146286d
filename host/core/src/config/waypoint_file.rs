//! Files that a person writes: the configuration's text, and waypoints or points of a path as CSV.
//!
//! Errors quote nothing of a file of points: they also reach clients of the control socket, who may not
//! be allowed to read it.

use std::{
    fs::OpenOptions,
    io::{self, Read as _},
    os::unix::fs::OpenOptionsExt as _,
    path::Path,
};

use singletrack_control::{Position, ReferenceError, Waypoint, Waypoints};

/// Longer than every valid configuration and every valid list of waypoints.
const LONGEST: u64 = 1 << 20;

/// The text of a file.
///
/// # Errors
///
/// The system's error; or the file is not a regular file, is too long, or is not UTF-8, each
/// with a fix.
pub(super) fn read_text(path: &Path) -> io::Result<String> {
    // Non-blocking: opening a pipe without a writer would wait for ever.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(libc::O_NONBLOCK)
        .open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        let kind = if metadata.is_dir() {
            "a folder"
        } else {
            "a pipe, a socket or a device"
        };
        return Err(io::Error::other(format!("it is {kind}; name a file")));
    }
    let mut bytes = Vec::new();
    // A regular file may still have no end, as in /proc.
    file.take(LONGEST + 1).read_to_end(&mut bytes)?;
    let length = metadata.len().max(bytes.len() as u64);
    if length > LONGEST {
        return Err(io::Error::other(format!(
            "it is {length} bytes long; at most {LONGEST} are read, is it the right file?"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let before = error.as_bytes().get(..good).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        io::Error::other(format!("line {line} is not UTF-8; save the file as UTF-8"))
    })
}

/// Why a file of waypoints is refused.
#[derive(Debug, thiserror::Error)]
pub enum WaypointFileError {
    /// The file can't be read.
    #[error("{0}")]
    File(#[from] io::Error),
    /// The file is not CSV.
    #[error("{0}; write one number for each column, such as 1.5,-0.5")]
    Csv(#[from] csv::Error),
    /// The first line does not name the columns.
    #[error("line 1 must name the columns {columns}, and no others")]
    Columns {
        /// The columns that it must name, in any order.
        columns: String,
    },
    /// A field is not a finite number.
    #[error("line {line}: {column} is no finite number; write one, as 0.5")]
    Number {
        /// Counted from 1.
        line: u64,
        /// The column of the field.
        column: &'static str,
    },
    /// The waypoints are not in order of time.
    #[error(
        "line {line}: t_s is {t_s}, not after {before_s} of the waypoint before; put the lines in order of time"
    )]
    Order {
        /// Counted from 1.
        line: u64,
        /// The time of the waypoint.
        t_s: f64,
        /// The time of the waypoint before.
        before_s: f64,
    },
    /// There are too few waypoints, or too many.
    #[error("{0}; write one waypoint a line")]
    Waypoints(#[from] ReferenceError),
}

/// The waypoints of a file.
pub(super) fn read_waypoints(path: &Path) -> Result<Waypoints, WaypointFileError> {
    let mut waypoints: Vec<Waypoint> = Vec::new();
    read_rows(path, ["t_s", "x_m", "y_m"], |line, [time, x, y]| {
        if let Some(before) = waypoints.last().filter(|before| time <= before.time) {
            return Err(WaypointFileError::Order {
                line,
                t_s: time,
                before_s: before.time,
            });
        }
        waypoints.push(Waypoint {
            time,
            position: Position::new(x, y),
        });
        Ok(())
    })?;
    Ok(Waypoints::new(&waypoints)?)
}

/// The points of a file, in m.
pub(super) fn read_points(path: &Path) -> Result<Vec<[f64; 2]>, WaypointFileError> {
    let mut points = Vec::new();
    read_rows(path, ["x_m", "y_m"], |_, point| {
        points.push(point);
        Ok(())
    })?;
    Ok(points)
}

/// Reads the rows of a file with these columns, and no others, in any order. `take` gets the
/// line's number and the numbers in the order of `columns`.
fn read_rows<const COLUMNS: usize>(
    path: &Path,
    columns: [&'static str; COLUMNS],
    mut take: impl FnMut(u64, [f64; COLUMNS]) -> Result<(), WaypointFileError>,
) -> Result<(), WaypointFileError> {
    let text = read_text(path)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers()?;
    let places: Vec<usize> = columns
        .iter()
        .filter_map(|name| header.iter().position(|column| column.trim() == *name))
        .collect();
    if header.len() != COLUMNS || places.len() != COLUMNS {
        return Err(WaypointFileError::Columns {
            columns: columns.join(","),
        });
    }
    for record in reader.records() {
        let record = record?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut row = [0.0; COLUMNS];
        for ((number, column), place) in row.iter_mut().zip(columns).zip(&places) {
            let value = record.get(*place).unwrap_or_default().trim();
            let finite = value.parse().ok().filter(|number: &f64| number.is_finite());
            *number = finite.ok_or(WaypointFileError::Number { line, column })?;
        }
        take(line, row)?;
    }
    Ok(())
}
