//! A log in a CSV file.

mod error;
mod row;

use std::path::Path;

use csv::{ErrorKind, ReaderBuilder, StringRecord, Trim};

pub use error::{Cell, CsvError, TimeFault};

use super::{
    FIRST_ROW_NS,
    columns::Columns,
    decimal,
    log::Log,
    map::{Map, RowTime, nanoseconds},
    row::Place,
};
use row::{Header, Row};

/// Reads the file `path` as `map` says.
pub(super) fn read(path: &Path, map: &Map) -> Result<Log, CsvError> {
    let failure = |error| failure(path, error);
    let mut reader = ReaderBuilder::new()
        .delimiter(u8::try_from(map.delimiter).unwrap_or(b','))
        .trim(Trim::All)
        .from_path(path)
        .map_err(failure)?;
    let names = reader.headers().map_err(failure)?.clone();
    if names.is_empty() {
        return Err(CsvError::Empty(path.to_owned()));
    }
    let mut header = Header::new(path, &names);
    let mut columns = Columns::find(&mut header, map)?;
    let mut clock = Clock::find(&header, map.time.of_rows(), map.time.longest_gap_s)?;
    let mut cells = StringRecord::new();
    while reader.read_record(&mut cells).map_err(failure)? {
        let row = header.row(&cells);
        let time_ns = clock.time_ns(&row)?;
        columns.take(&row, time_ns)?;
    }
    match clock.ends() {
        Some((start_wall_ns, end_ns)) => Ok(columns.log(map, start_wall_ns, end_ns)),
        None => Err(CsvError::NoRows(path.to_owned())),
    }
}

/// An error of the CSV reader, with file, line and fix.
fn failure(path: &Path, error: csv::Error) -> CsvError {
    let line = |position: &Option<csv::Position>| row::line(path, position.as_ref());
    match error.kind() {
        ErrorKind::UnequalLengths {
            pos,
            expected_len,
            len,
        } => CsvError::Cells {
            path: path.to_owned(),
            line: line(pos),
            found: *len,
            expected: *expected_len,
        },
        ErrorKind::Utf8 { pos, .. } => CsvError::NotUtf8 {
            path: path.to_owned(),
            line: line(pos),
        },
        _ => CsvError::Read {
            path: path.to_owned(),
            source: error,
        },
    }
}

/// The time of the rows.
struct Clock<'a> {
    time: RowTime<'a>,
    place: Place,
    longest_gap_ns: u64,
    /// The first and the last time, in ns from the zero of the log.
    span: Option<(i64, i64)>,
}

impl<'a> Clock<'a> {
    fn find(header: &Header<'_>, time: RowTime<'a>, longest_gap_s: f64) -> Result<Self, CsvError> {
        Ok(Self {
            time,
            place: header.place("time.column", time.column)?,
            longest_gap_ns: nanoseconds(longest_gap_s),
            span: None,
        })
    }

    /// The time of a row on the clock of the record.
    fn time_ns(&mut self, row: &Row<'_>) -> Result<u64, CsvError> {
        let cell = row.cell(self.place);
        let time = decimal::scaled(cell, self.time.unit.exponent()).ok_or_else(|| {
            let fix = "correct the cell, remove the row, or name another time.column in the map";
            row.error(self.place, "a time as a decimal number", fix)
        })?;
        let (first, before) = self.span.unwrap_or((time, time));
        let since_ns = time.abs_diff(before);
        let since_s = since_ns as f64 * 1e-9;
        let fault = if self.time.unix && time < 0 {
            TimeFault::BeforeUnix
        } else if time < before {
            TimeFault::Backwards { back_s: since_s }
        } else if since_ns > self.longest_gap_ns {
            TimeFault::LongGap { gap_s: since_s }
        } else {
            self.span = Some((first, time));
            return Ok(FIRST_ROW_NS.saturating_add(time.abs_diff(first)));
        };
        Err(row.time_error(self.place, fault))
    }

    /// The wall time of the first row, and the time of the last one on the clock of the record;
    /// `None` without a row.
    fn ends(&self) -> Option<(u64, u64)> {
        let (first, last) = self.span?;
        let wall_ns = match self.time.unix {
            true => first.unsigned_abs(),
            false => 0,
        };
        Some((wall_ns, FIRST_ROW_NS.saturating_add(last.abs_diff(first))))
    }
}
