//! A log in a CSV file.

mod row;

use std::path::Path;

use csv::{ErrorKind, ReaderBuilder, StringRecord, Trim};

use super::{
    FIRST_ROW_NS,
    columns::Columns,
    decimal,
    log::{ImportError, JITTER_NS, Log, duration},
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
    let mut rows: Vec<(i64, StringRecord)> = Vec::new();
    let mut cells = StringRecord::new();
    while reader.read_record(&mut cells).map_err(failure)? {
        rows.push((clock.time(&header.row(&cells))?, cells.clone()));
    }
    rows.sort_by_key(|(time, _)| *time);
    let (Some((first, _)), Some((last, _))) = (rows.first(), rows.last()) else {
        let why = " has the names of the columns, but no rows: there is nothing to import";
        return Err(ImportError::file(path, why));
    };
    let since_first = |time: i64| FIRST_ROW_NS.saturating_add(time.abs_diff(*first));
    for (time, cells) in &rows {
        columns.take(&header.row(cells), since_first(*time))?;
    }
    let start_wall_ns = match clock.unix {
        true => first.unsigned_abs(),
        false => 0,
    };
    Ok(columns.log(map, start_wall_ns, since_first(*last), clock.sorted))
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
    /// The latest time so far, in ns from the zero of the log.
    latest: Option<i64>,
    /// Rows that were before an earlier one by a little.
    sorted: u64,
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
            latest: None,
            sorted: 0,
        })
    }

    /// The time of a row, in ns from the zero of the log.
    fn time(&mut self, row: &Row<'_>) -> Result<i64, ImportError> {
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
        let before = self.latest.unwrap_or(time);
        let since_ns = time.abs_diff(before);
        let fault = if self.unix && time < 0 {
            " is before 1970: set time.unix = false in the map".to_owned()
        } else if time < before && since_ns > JITTER_NS {
            format!(
                " is {} before a row above: put the rows in the order of time, or remove \
                 those of another log",
                duration(since_ns)
            )
        } else if since_ns > self.longest_gap_ns {
            format!(
                " is {} after the row above: remove the rows on one side of the gap, \
                 correct time.unit in the map, or raise its time.longest_gap_s",
                duration(since_ns)
            )
        } else {
            self.sorted += u64::from(time < before);
            self.latest = Some(time.max(before));
            return Ok(time);
        };
        Err(row.error(self.place, &fault))
    }
}
