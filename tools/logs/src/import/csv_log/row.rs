//! The cells of a row, by the places of their columns.

use std::{
    fs::File,
    io::{self, BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use csv::{Position, StringRecord};

use crate::import::{
    log::ImportError,
    map::Messages,
    row::{self, Place},
};

/// The number of the line of a row, from 1. The position of the CSV reader is that of the blank
/// lines before the row.
pub(super) fn line(path: &Path, position: Option<&Position>) -> u64 {
    let Some(position) = position else {
        return 1;
    };
    let blank = || -> io::Result<u64> {
        let mut file = BufReader::new(File::open(path)?);
        file.seek(SeekFrom::Start(position.byte()))?;
        let mut blank = 0;
        for byte in file.bytes() {
            match byte? {
                b'\n' => blank += 1,
                b'\r' => {}
                _ => break,
            }
        }
        Ok(blank)
    };
    // A file that can't be read any more has an error of its own.
    position.line() + blank().unwrap_or_default()
}

/// A file of the log, with the names of its columns.
pub(super) struct Table<'a> {
    pub(super) path: &'a Path,
    pub(super) names: StringRecord,
    /// Its number among the files, from 0.
    pub(super) source: usize,
}

impl<'a> Table<'a> {
    fn has(&self, column: &str) -> bool {
        self.names.iter().any(|name| name == column)
    }

    /// The place of the column that `key` in the map names.
    pub(super) fn place(&self, key: &'static str, column: &str) -> Result<Place, ImportError> {
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
        match places.count() {
            0 => Ok(Place {
                source: self.source,
                index,
            }),
            others => {
                let count = others + 1;
                let why = format!(
                    " has {count} columns {column:?}, and {key} in the map names one: rename the \
                     others in the file"
                );
                Err(ImportError::file(self.path, why))
            }
        }
    }

    /// A row of the file.
    pub(super) const fn row(&'a self, cells: &'a StringRecord) -> Row<'a> {
        Row { table: self, cells }
    }
}

/// The files of a log, of which each section of the map has one.
pub(super) struct Tables<'a> {
    tables: &'a [Table<'a>],
    /// The sections so far, each with a key and the file of its column.
    sections: Vec<(&'static str, &'static str, &'a Table<'a>)>,
}

impl<'a> Tables<'a> {
    pub(super) const fn new(tables: &'a [Table<'a>]) -> Self {
        Self {
            tables,
            sections: Vec::new(),
        }
    }
}

impl row::Header for Tables<'_> {
    fn find(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &str,
    ) -> Result<Place, ImportError> {
        let mut having = self.tables.iter().filter(|table| table.has(column));
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
pub(super) struct Row<'a> {
    table: &'a Table<'a>,
    cells: &'a StringRecord,
}

impl<'a> Row<'a> {
    /// A cell, without spaces around it.
    pub(super) fn cell(&self, place: Place) -> &'a str {
        self.cells.get(place.index).unwrap_or_default()
    }

    /// An error in a cell.
    pub(super) fn error(&self, place: Place, why: &str) -> ImportError {
        let Table { path, names, .. } = self.table;
        let line = line(path, self.cells.position());
        let column = names.get(place.index).unwrap_or_default();
        let value = self.cell(place);
        let cell = format!(", line {line}, column {column:?}: {value:?}");
        ImportError::file(path, cell + why)
    }
}

impl row::Row for Row<'_> {
    fn has(&self, place: Place) -> bool {
        place.source == self.table.source
    }

    fn cell(&self, place: Place) -> row::Cell<'_> {
        row::Cell::of(self.cell(place))
    }

    fn wrong(&self, place: Place, expected: &str) -> ImportError {
        let fix = comma_fix(self.cell(place)).unwrap_or("correct the cell or remove the row");
        self.error(place, &format!(" is not {expected}: {fix}"))
    }
}

/// What to do about a number with a decimal comma: one program writes all of them so.
pub(super) fn comma_fix(cell: &str) -> Option<&'static str> {
    let is_number = cell.replacen(',', ".", 1).parse::<f64>().is_ok();
    (cell.contains(',') && is_number).then_some(
        "it has a decimal comma: replace those of the file, such as with `sed 's/,/./g'`",
    )
}
