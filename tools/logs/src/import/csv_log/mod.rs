//! A log in CSV files.

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
use row::{Row, Table, Tables};

/// Reads the files `paths`, which are one log, as `map` says.
pub(super) fn read(paths: &[&Path], map: &Map) -> Result<Log, ImportError> {
    let mut tables = Vec::new();
    let mut rows: Vec<(i64, usize, StringRecord)> = Vec::new();
    let mut sorted = 0;
    for (source, path) in paths.iter().copied().enumerate() {
        let failure = |error| failure(path, error);
        let mut reader = ReaderBuilder::new()
            .delimiter(u8::try_from(map.delimiter).unwrap_or(b','))
            .trim(Trim::All)
            .from_path(path)
            .map_err(failure)?;
        let names = reader.headers().map_err(failure)?.clone();
        if names.is_empty() {
            let why = " is empty: it needs a line with the names of the columns, and a line for each \
                       sample";
            return Err(ImportError::file(path, why));
        }
        let table = Table {
            path,
            names,
            source,
        };
        let mut clock = Clock::find(&table, &map.time)?;
        let first = rows.len();
        let mut cells = StringRecord::new();
        while reader.read_record(&mut cells).map_err(failure)? {
            rows.push((clock.time(&table.row(&cells))?, source, cells.clone()));
        }
        if rows.len() == first {
            let why = " has the names of the columns, but no rows: there is nothing to import";
            return Err(ImportError::file(path, why));
        }
        check_overlap(&rows, first, path)?;
        sorted += clock.sorted;
        tables.push(table);
    }
    let mut columns = Columns::find(&mut Tables::new(&tables), map)?;
    rows.sort_by_key(|(time, ..)| *time);
    let times = rows.first().zip(rows.last());
    let (first, last) = times.map_or((0, 0), |(first, last)| (first.0, last.0));
    let since_first = |time: i64| FIRST_ROW_NS.saturating_add(time.abs_diff(first));
    for (time, source, cells) in &rows {
        if let Some(table) = tables.get(*source) {
            columns.take(&table.row(cells), since_first(*time))?;
        }
    }
    let start_wall_ns = match map.time.unix {
        Some(true) => first.unsigned_abs(),
        _ => 0,
    };
    Ok(columns.log(map, start_wall_ns, since_first(last), sorted))
}

/// Refuses a file with the rows from `first` on that has no time in common with those before.
fn check_overlap(
    rows: &[(i64, usize, StringRecord)],
    first: usize,
    path: &Path,
) -> Result<(), ImportError> {
    let (before, own) = rows.split_at_checked(first).unwrap_or((rows, &[]));
    let span = |rows: &[(i64, usize, StringRecord)]| {
        let times = rows.iter().map(|(time, ..)| *time);
        times.clone().min().zip(times.max())
    };
    let (Some((begin, end)), Some((from, to))) = (span(before), span(own)) else {
        return Ok(());
    };
    if from <= end && begin <= to {
        return Ok(());
    }
    let apart = from.saturating_sub(end).max(begin.saturating_sub(to));
    let why = format!(
        " is {} apart from the files before it: the files of a drive need one clock in time.column",
        duration(apart.unsigned_abs())
    );
    Err(ImportError::file(path, why))
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
    fn find(table: &Table<'_>, time: &TimeSection) -> Result<Self, ImportError> {
        let column = time.column.as_deref().unwrap_or_default();
        Ok(Self {
            place: table.place("time.column", column)?,
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
