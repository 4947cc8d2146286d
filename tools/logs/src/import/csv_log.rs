//! A log in CSV files.

use std::{
    fs::File,
    io::{self, BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use csv::{ErrorKind, Position, ReaderBuilder, StringRecord, Trim};

use super::{
    FIRST_ROW_NS,
    columns::{self, Columns, Place},
    log::{ImportError, JITTER_NS, Log, duration},
    map::{Map, Messages, TimeSection},
};

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
    let mut header = Tables {
        tables: &tables,
        sections: Vec::new(),
    };
    let mut columns = Columns::find(&mut header, map)?;
    rows.sort_by_key(|(time, ..)| *time);
    let times = rows.first().zip(rows.last());
    let (first, last) = times.map_or((0, 0), |(first, last)| (first.0, last.0));
    let since_first = |time: i64| FIRST_ROW_NS.saturating_add(time.abs_diff(first));
    for (time, source, cells) in &rows {
        columns.take(&tables[*source].row(cells), since_first(*time))?;
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
    let why = match error.kind() {
        ErrorKind::UnequalLengths {
            expected_len: names,
            len: cells,
            ..
        } => format!("the row has {cells} cells and the header {names}: correct or remove the row"),
        ErrorKind::Utf8 { .. } => {
            "the row is not UTF-8: convert the file, such as with `iconv -t UTF-8`".to_owned()
        }
        _ => return ImportError::read(path)(error),
    };
    let line = line(path, error.position());
    ImportError::file(path, format!(", line {line}: {why}"))
}

/// The time of the rows.
struct Clock<'a> {
    place: Place,
    section: &'a TimeSection,
    /// The latest time so far, in ns from the zero of the log.
    latest: Option<i64>,
    /// Rows that were before an earlier one by a little.
    sorted: u64,
}

impl<'a> Clock<'a> {
    /// The clock of a section that [is one for rows](TimeSection::check_rows).
    fn find(table: &Table<'_>, section: &'a TimeSection) -> Result<Self, ImportError> {
        let column = section.column.as_deref().unwrap_or_default();
        Ok(Self {
            place: table.place("time.column", column)?,
            section,
            latest: None,
            sorted: 0,
        })
    }

    /// The time of a row, in ns from the zero of the log.
    fn time(&mut self, row: &Row<'_>) -> Result<i64, ImportError> {
        let cell = row.cell(self.place);
        let unit = self.section.unit.unwrap_or_default();
        let time = scaled(cell, unit as i32).ok_or_else(|| {
            let fix = "correct the cell, remove the row, or name another time.column in the map";
            let fix = comma_fix(cell).unwrap_or(fix);
            let why = format!(" is not a time as a decimal number: {fix}");
            row.error(self.place, &why)
        })?;
        let before = self.latest.unwrap_or(time);
        let since_ns = time.abs_diff(before);
        let fault = if self.section.unix == Some(true) && time < 0 {
            " is before 1970: set time.unix = false in the map".to_owned()
        } else if time < before && since_ns > JITTER_NS {
            format!(
                " is {} before a row above: put the rows in the order of time, or remove \
                 those of another log",
                duration(since_ns)
            )
        } else if since_ns > self.section.longest_gap_ns() {
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

/// The number of the line of a row, from 1. The position of the CSV reader is that of the blank
/// lines before the row.
fn line(path: &Path, position: Option<&Position>) -> u64 {
    let Some(position) = position else {
        return 1;
    };
    let blank = || -> io::Result<u64> {
        let mut file = BufReader::new(File::open(path)?);
        file.seek(SeekFrom::Start(position.byte()))?;
        let bytes = file.bytes().map_while(Result::ok);
        let ends = bytes.take_while(|byte| matches!(byte, b'\n' | b'\r'));
        Ok(ends.filter(|byte| *byte == b'\n').count() as u64)
    };
    // A file that can't be read any more has an error of its own.
    position.line() + blank().unwrap_or_default()
}

/// A file of the log, with the names of its columns.
struct Table<'a> {
    path: &'a Path,
    names: StringRecord,
    /// Its number among the files, from 0.
    source: usize,
}

impl<'a> Table<'a> {
    /// The place of the column that `key` in the map names.
    fn place(&self, key: &'static str, column: &str) -> Result<Place, ImportError> {
        let names = self.names.iter().enumerate();
        let mut places = names.filter(|(_, name)| *name == column);
        let Some((index, _)) = places.next() else {
            let columns: Vec<_> = self.names.iter().map(|name| format!("{name:?}")).collect();
            let columns = columns.join(", ");
            let why = format!(
                " has no column {column:?}, which {key} in the map names; its columns are {columns}"
            );
            return Err(ImportError::file(self.path, why));
        };
        let (count, source) = (1 + places.count(), self.source);
        if count > 1 {
            let why = format!(
                " has {count} columns {column:?}, and {key} in the map names one: rename the others in \
                 the file"
            );
            return Err(ImportError::file(self.path, why));
        }
        Ok(Place { source, index })
    }

    /// A row of the file.
    const fn row(&'a self, cells: &'a StringRecord) -> Row<'a> {
        Row { table: self, cells }
    }
}

/// The files of a log, of which each section of the map has one.
struct Tables<'a> {
    tables: &'a [Table<'a>],
    /// The sections so far, each with a key and the file of its column.
    sections: Vec<(&'static str, &'static str, &'a Table<'a>)>,
}

impl columns::Header for Tables<'_> {
    fn find(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &str,
    ) -> Result<Place, ImportError> {
        let has = |table: &&Table<'_>| table.names.iter().any(|name| name == column);
        let mut having = self.tables.iter().filter(has);
        let found = having.next();
        if let Some((one, other)) = found.zip(having.next()) {
            let why = format!(
                " has a column {column:?}, as {} has, and {key} in the map names one: rename it in one of \
                 the files",
                one.path.display()
            );
            return Err(ImportError::file(other.path, why));
        }
        // Without the column, the error is that of the first file.
        let Some(table) = found.or(self.tables.first()) else {
            return Err(ImportError::Invalid(
                "there is no file to import".to_owned(),
            ));
        };
        let section = messages.section;
        let known = self.sections.iter().find(|(name, ..)| *name == section);
        match known {
            Some((_, first, other)) if found.is_some() && other.source != table.source => {
                let why = format!(
                    " has the column of {key}, and {} that of {first}: put all columns of [{section}] into \
                     one file",
                    other.path.display()
                );
                return Err(ImportError::file(table.path, why));
            }
            Some(_) => {}
            None => self.sections.push((section, key, table)),
        }
        table.place(key, column)
    }
}

/// A row of a file.
#[derive(Clone, Copy)]
struct Row<'a> {
    table: &'a Table<'a>,
    cells: &'a StringRecord,
}

impl<'a> Row<'a> {
    /// A cell, without spaces around it.
    fn cell(&self, place: Place) -> &'a str {
        self.cells.get(place.index).unwrap_or_default()
    }

    /// An error in a cell.
    fn error(&self, place: Place, why: &str) -> ImportError {
        let Table { path, names, .. } = self.table;
        let line = line(path, self.cells.position());
        let column = names.get(place.index).unwrap_or_default();
        let value = self.cell(place);
        let cell = format!(", line {line}, column {column:?}: {value:?}");
        ImportError::file(path, cell + why)
    }
}

impl columns::Row for Row<'_> {
    fn has(&self, place: Place) -> bool {
        place.source == self.table.source
    }

    fn cell(&self, place: Place) -> columns::Cell<'_> {
        columns::Cell::of(self.cell(place))
    }

    fn wrong(&self, place: Place, expected: &str) -> ImportError {
        let fix = comma_fix(self.cell(place)).unwrap_or("correct the cell or remove the row");
        self.error(place, &format!(" is not {expected}: {fix}"))
    }
}

/// What to do about a number with a decimal comma: one program writes all of them so.
fn comma_fix(cell: &str) -> Option<&'static str> {
    let is_number = cell.replacen(',', ".", 1).parse::<f64>().is_ok();
    (cell.contains(',') && is_number).then_some(
        "it has a decimal comma: replace those of the file, such as with `sed 's/,/./g'`",
    )
}

/// Digits below this power of ten of the result are left out.
const LEAST_POWER: i32 = -9;

/// The decimal number `text` times 10 to the power of `exponent`, rounded to the nearest
/// integer; `None` if it is not a decimal number or does not fit.
///
/// A unix time in seconds with seven decimals has more digits than a float: the difference of two would
/// be wrong by 0.2 us.
fn scaled(text: &str, exponent: i32) -> Option<i64> {
    let (text, written) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (is_negative, text) = match text.strip_prefix('-') {
        Some(text) => (true, text),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    let mut digits: i128 = 0;
    let mut shift = exponent.checked_add(written)?;
    for (place, byte) in whole.bytes().chain(fraction.bytes()).enumerate() {
        let digit = byte.is_ascii_digit().then(|| i128::from(byte - b'0'))?;
        if place >= whole.len() {
            if shift <= LEAST_POWER {
                continue;
            }
            shift -= 1;
        }
        digits = digits.checked_mul(10)?.checked_add(digit)?;
    }
    let power = |shift: i32| 10_i128.checked_pow(shift.unsigned_abs());
    let value = match shift {
        0.. if digits == 0 => 0,
        0.. => digits.checked_mul(power(shift)?)?,
        _ => match power(shift) {
            Some(divisor) => (digits + divisor / 2) / divisor,
            None => 0,
        },
    };
    i64::try_from(if is_negative { -value } else { value }).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_digit_of_a_unix_time_counts() {
        for (text, exponent, number) in [
            ("1706804704.2263625", 9, 1_706_804_704_226_362_500),
            ("1706804704226.3625", 6, 1_706_804_704_226_362_500),
            ("1706804704226362501", 0, 1_706_804_704_226_362_501),
            ("1.7068047042263625e9", 9, 1_706_804_704_226_362_500),
            ("0.0000000014", 9, 1),
            ("0.0000000015", 9, 2),
            ("-0.5", 9, -500_000_000),
            ("+.5", 9, 500_000_000),
            ("5.", 0, 5),
            ("0e30", 9, 0),
            ("1e-50", 9, 0),
        ] {
            assert_eq!(scaled(text, exponent), Some(number), "{text}");
        }
    }

    #[test]
    fn many_decimals_are_rounded() {
        let third = format!("0.{}", "3".repeat(60));
        assert_eq!(scaled(&third, 9), Some(333_333_333));
    }

    #[test]
    fn what_is_no_decimal_number_or_too_large_is_refused() {
        for text in [
            "",
            ".",
            "-",
            "nan",
            "inf",
            "1.2.3",
            "1 2",
            "0x10",
            "1e",
            "1e99",
            "12:00",
            "--1",
            "9300000000000",
            "1e2147483647",
        ] {
            assert_eq!(scaled(text, 9), None, "{text}");
        }
    }
}
