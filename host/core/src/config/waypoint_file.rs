//! A file of waypoints: CSV with the columns `t_s,x_m,y_m`.

use std::{io, path::Path};

use singletrack_control::{Position, ReferenceError, Waypoint, Waypoints};

use super::file::read_text;

/// The columns, in any order.
const COLUMNS: [&str; 3] = ["t_s", "x_m", "y_m"];

/// Why a file of waypoints is refused.
#[derive(Debug, thiserror::Error)]
pub enum WaypointFileError {
    /// The file cannot be read.
    #[error("{0}")]
    File(#[from] io::Error),
    /// The file is not CSV.
    #[error("{0}; write three numbers a line, as 0.0,1.5,-0.5")]
    Csv(#[from] csv::Error),
    /// The first line does not name the columns.
    #[error("line 1 is {found:?}; it must name the columns t_s,x_m,y_m")]
    Columns {
        /// The first line.
        found: String,
    },
    /// A field is not a finite number.
    #[error("line {line}: {column} is {value:?}; write a finite number, as 0.5")]
    Number {
        /// Counted from 1.
        line: u64,
        /// The column of the field.
        column: &'static str,
        /// The text of the field.
        value: String,
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
    let text = read_text(path)?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers()?;
    let column = |name| header.iter().position(|column| column.trim() == name);
    let (3, [Some(t), Some(x), Some(y)]) = (header.len(), COLUMNS.map(column)) else {
        return Err(WaypointFileError::Columns {
            found: header.iter().collect::<Vec<_>>().join(","),
        });
    };
    let mut waypoints: Vec<Waypoint> = Vec::new();
    for record in reader.records() {
        let record = record?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |index: usize, column| {
            let value = record.get(index).unwrap_or_default().trim();
            let number = value.parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| WaypointFileError::Number {
                line,
                column,
                value: value.to_owned(),
            })
        };
        let time = number(t, "t_s")?;
        if let Some(before) = waypoints.last().filter(|before| time <= before.time) {
            return Err(WaypointFileError::Order {
                line,
                t_s: time,
                before_s: before.time,
            });
        }
        waypoints.push(Waypoint {
            time,
            position: Position::new(number(x, "x_m")?, number(y, "y_m")?),
        });
    }
    Ok(Waypoints::new(&waypoints)?)
}
