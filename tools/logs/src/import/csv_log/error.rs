//! Why a CSV file can't be imported.

use std::{fmt, path::PathBuf};

/// A CSV file that can't be imported. Lines are counted from 1, which is the header.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// The file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: csv::Error,
    },
    /// There is not even a header.
    #[error("{} is empty: it needs a line with the names of the columns, and a line for each sample", .0.display())]
    Empty(PathBuf),
    /// There is nothing but a header.
    #[error("{} has the names of the columns, but no rows: there is nothing to import", .0.display())]
    NoRows(PathBuf),
    /// A row has more or fewer cells than the header.
    #[error("{}, line {line}: the row has {found} cells and the header {expected}: correct or remove the row", path.display())]
    Cells {
        /// The file.
        path: PathBuf,
        /// The line of the row.
        line: u64,
        /// Its cells.
        found: u64,
        /// Those of the header.
        expected: u64,
    },
    /// A row is not text.
    #[error("{}, line {line}: the row is not UTF-8: convert the file, such as with `iconv -t UTF-8`", path.display())]
    NotUtf8 {
        /// The file.
        path: PathBuf,
        /// The line of the row.
        line: u64,
    },
    /// The map names a column that the file does not have.
    #[error("{} has no column {column:?}, which {key} in the map names; its columns are {columns}", path.display())]
    NoColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// The key of the map.
        key: &'static str,
        /// Those that the file has.
        columns: String,
    },
    /// The map names a column that the file has more than once.
    #[error("{} has {count} columns {column:?}, and {key} in the map names one: rename the others in the file", path.display())]
    SameColumns {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// The key of the map.
        key: &'static str,
        /// How many there are.
        count: usize,
    },
    /// A cell can't be understood.
    #[error("{cell} is not {expected}: {fix}")]
    Cell {
        /// The cell.
        cell: Cell,
        /// What it should be.
        expected: &'static str,
        /// What to do.
        fix: &'static str,
    },
    /// The time of a row can't be right.
    #[error("{cell} {fault}")]
    Time {
        /// The time in the file.
        cell: Cell,
        /// Why not.
        fault: TimeFault,
    },
}

/// A cell of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cell {
    /// The file.
    pub path: PathBuf,
    /// The line of the row.
    pub line: u64,
    /// The column.
    pub column: String,
    /// The contents.
    pub value: String,
}

impl fmt::Display for Cell {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            path,
            line,
            column,
            value,
        } = self;
        let path = path.display();
        write!(
            formatter,
            "{path}, line {line}, column {column:?}: {value:?}"
        )
    }
}

/// Why the time of a row can't be right.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TimeFault {
    /// It goes backwards.
    #[error(
        "is {back_s} s before the row above: put the rows in the order of time, or remove those of another log"
    )]
    Backwards {
        /// How far, in s.
        back_s: f64,
    },
    /// It jumps ahead.
    #[error(
        "is {gap_s} s after the row above: remove the rows on one side of the gap, correct time.unit in the map, or raise its time.longest_gap_s"
    )]
    LongGap {
        /// How far, in s.
        gap_s: f64,
    },
    /// A unix time is negative.
    #[error("is before 1970: set time.unix = false in the map")]
    BeforeUnix,
}
