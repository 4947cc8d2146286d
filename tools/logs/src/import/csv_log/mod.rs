//! A log in a CSV file.

mod row;

use std::path::Path;

use csv::{ErrorKind, ReaderBuilder, StringRecord, Trim};

use super::{
    FIRST_ROW_NS,
    columns::Columns,
    decimal,
    log::ImportError,
    log::Log,
    map::{Map, TimeSection, TimeUnit, nanoseconds},
    row::Place,
};
use row::{Header, Row};

/// Reads the file `path` as `map` says.
pub(super) fn read(path: &Path, map: &Map) -> Result<Log, ImportError> {
    let failure = |error| failure(path, error);
    let mut reader = ReaderBuilder::new()
        .delimiter(u8::try_from(map.delimiter).unwrap_or(b','))
        .trim(Trim::All)
        .from_path(path)
        .map_err(failure)?;
    let names = &reader.headers().map_err(failure)?.clone();
    if names.is_empty() {
        let why = " is empty: it needs a line with the names of the columns, and a line for each \
                   sample";
        return Err(ImportError::file(path, why));
    }
    let mut header = Header { path, names };
    let mut columns = Columns::find(&mut header, map)?;
    let mut clock = Clock::find(&header, &map.time)?;
    let mut cells = StringRecord::new();
    while reader.read_record(&mut cells).map_err(failure)? {
        let row = header.row(&cells);
        let time_ns = clock.time_ns(&row)?;
        columns.take(&row, time_ns)?;
    }
    match clock.ends() {
        Some((start_wall_ns, end_ns)) => Ok(columns.log(map, start_wall_ns, end_ns)),
        None => {
            let why = " has the names of the columns, but no rows: there is nothing to import";
            Err(ImportError::file(path, why))
        }
    }
}

/// An error of the CSV reader, with file, line and fix.
fn failure(path: &Path, error: csv::Error) -> ImportError {
    let (position, why) = match error.kind() {
        ErrorKind::UnequalLengths {
            pos,
            expected_len,
            len,
        } => (
            pos,
            format!(
                "the row has {len} cells and the header {expected_len}: correct or remove the row"
            ),
        ),
        ErrorKind::Utf8 { pos, .. } => (
            pos,
            "the row is not UTF-8: convert the file, such as with `iconv -t UTF-8`".to_owned(),
        ),
        _ => return ImportError::read(path)(error),
    };
    let line = row::line(path, position.as_ref());
    ImportError::file(path, format!(", line {line}: {why}"))
}

/// The time of the rows.
struct Clock {
    place: Place,
    unit: TimeUnit,
    unix: bool,
    longest_gap_ns: u64,
    /// The first and the last time, in ns from the zero of the log.
    span: Option<(i64, i64)>,
}

impl Clock {
    /// Of a section that [is one for rows](TimeSection::check_rows).
    fn find(header: &Header<'_>, time: &TimeSection) -> Result<Self, ImportError> {
        let column = time.column.as_deref().unwrap_or_default();
        Ok(Self {
            place: header.place("time.column", column)?,
            unit: time.unit.unwrap_or_default(),
            unix: time.unix.unwrap_or_default(),
            longest_gap_ns: nanoseconds(time.longest_gap_s),
            span: None,
        })
    }

    /// The time of a row on the clock of the record.
    fn time_ns(&mut self, row: &Row<'_>) -> Result<u64, ImportError> {
        let cell = row.cell(self.place);
        let time = decimal::scaled(cell, self.unit.exponent()).ok_or_else(|| {
            let fix = row::comma_fix(cell).unwrap_or(
                "correct the cell, remove the row, or name another time.column in the map",
            );
            row.error(
                self.place,
                &format!(" is not a time as a decimal number: {fix}"),
            )
        })?;
        let (first, before) = self.span.unwrap_or((time, time));
        let since_ns = time.abs_diff(before);
        let since_s = since_ns as f64 * 1e-9;
        let fault = if self.unix && time < 0 {
            " is before 1970: set time.unix = false in the map".to_owned()
        } else if time < before {
            format!(
                " is {since_s} s before the row above: put the rows in the order of time, or remove \
                 those of another log"
            )
        } else if since_ns > self.longest_gap_ns {
            format!(
                " is {since_s} s after the row above: remove the rows on one side of the gap, \
                 correct time.unit in the map, or raise its time.longest_gap_s"
            )
        } else {
            self.span = Some((first, time));
            return Ok(FIRST_ROW_NS.saturating_add(time.abs_diff(first)));
        };
        Err(row.error(self.place, &fault))
    }

    /// The wall time of the first row, and the time of the last one on the clock of the record;
    /// `None` without a row.
    fn ends(&self) -> Option<(u64, u64)> {
        let (first, last) = self.span?;
        let wall_ns = match self.unix {
            true => first.unsigned_abs(),
            false => 0,
        };
        Some((wall_ns, FIRST_ROW_NS.saturating_add(last.abs_diff(first))))
    }
}
