//! A file of waypoints, CSV with the columns `t_s,x_m,y_m`, or of the points of a path, with
//! the columns `x_m,y_m`.
//!
//! Errors quote nothing of a file: they also reach clients of the control socket, who may not be
//! allowed to read it.

use std::path::Path;

use singletrack_control::{Position, Waypoint, Waypoints};

use super::file::read_text;

/// Why a file of waypoints is refused: in words, with the line.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WaypointFileError(String);

/// The waypoints of a file.
pub(super) fn read_waypoints(path: &Path) -> Result<Waypoints, WaypointFileError> {
    let mut waypoints: Vec<Waypoint> = Vec::new();
    read_rows(path, ["t_s", "x_m", "y_m"], |line, [time, x, y]| {
        if let Some(before) = waypoints.last().filter(|before| time <= before.time) {
            return Err(WaypointFileError(format!(
                "line {line}: t_s is {time}, not after {} of the waypoint before; put the lines in \
                 order of time",
                before.time
            )));
        }
        waypoints.push(Waypoint {
            time,
            position: Position::new(x, y),
        });
        Ok(())
    })?;
    // Too few, or too many.
    Waypoints::new(&waypoints)
        .map_err(|error| WaypointFileError(format!("{error}; write one waypoint a line")))
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
    let no_csv = |error| {
        WaypointFileError(format!(
            "{error}; write one number for each column, such as 1.5,-0.5"
        ))
    };
    let text = read_text(path).map_err(|error| WaypointFileError(error.to_string()))?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(no_csv)?;
    let places: Vec<usize> = columns
        .iter()
        .filter_map(|name| header.iter().position(|column| column.trim() == *name))
        .collect();
    if header.len() != COLUMNS || places.len() != COLUMNS {
        return Err(WaypointFileError(format!(
            "line 1 must name the columns {}, and no others",
            columns.join(",")
        )));
    }
    for record in reader.records() {
        let record = record.map_err(no_csv)?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut row = [0.0; COLUMNS];
        for ((number, column), place) in row.iter_mut().zip(columns).zip(&places) {
            let value = record.get(*place).unwrap_or_default().trim();
            let finite = value.parse().ok().filter(|number: &f64| number.is_finite());
            *number = finite.ok_or_else(|| {
                WaypointFileError(format!(
                    "line {line}: {column} is no finite number; write one, as 0.5"
                ))
            })?;
        }
        take(line, row)?;
    }
    Ok(())
}
