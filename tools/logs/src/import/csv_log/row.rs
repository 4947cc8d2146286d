//! The cells of a row, by the places of their columns.

use std::{
    borrow::Cow,
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

/// The columns of a file.
pub(super) struct Header<'a> {
    pub(super) path: &'a Path,
    pub(super) names: &'a StringRecord,
}

impl<'a> Header<'a> {
    /// The place of the column that `key` in the map names.
    pub(super) fn place(&self, key: &'static str, column: &str) -> Result<Place, ImportError> {
        let names = self.names.iter().enumerate();
        let mut places = names.filter(|(_, name)| *name == column);
        let Some((place, _)) = places.next() else {
            let columns: Vec<_> = self.names.iter().map(|name| format!("{name:?}")).collect();
            let columns = columns.join(", ");
            let why = format!(
                " has no column {column:?}, which {key} in the map names; its columns are {columns}"
            );
            return Err(ImportError::file(self.path, why));
        };
        match places.count() {
            0 => Ok(Place {
                source: 0,
                index: place,
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
    pub(super) fn row(&self, cells: &'a StringRecord) -> Row<'_> {
        Row {
            header: self,
            cells,
        }
    }
}

impl row::Header for Header<'_> {
    fn find(
        &mut self,
        key: &'static str,
        _messages: Messages<'_>,
        column: &str,
    ) -> Result<Place, ImportError> {
        self.place(key, column)
    }
}

/// A row of a file.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    header: &'a Header<'a>,
    cells: &'a StringRecord,
}

impl<'a> Row<'a> {
    /// A cell, without spaces around it.
    pub(super) fn cell(&self, place: Place) -> &'a str {
        self.cells.get(place.index).unwrap_or_default()
    }

    /// An error in a cell.
    pub(super) fn error(&self, place: Place, why: &str) -> ImportError {
        let Header { path, names } = self.header;
        let line = line(path, self.cells.position());
        let column = names.get(place.index).unwrap_or_default();
        let value = self.cell(place);
        let cell = format!(", line {line}, column {column:?}: {value:?}");
        ImportError::file(path, cell + why)
    }
}

impl row::Row for Row<'_> {
    fn has(&self, _place: Place) -> bool {
        true
    }

    fn is_empty(&self, place: Place) -> bool {
        self.cell(place).is_empty()
    }

    fn text(&self, place: Place) -> Cow<'_, str> {
        Cow::Borrowed(self.cell(place))
    }

    fn number(&self, place: Place) -> Result<f64, ImportError> {
        match self.cell(place) {
            "" => Ok(f64::NAN),
            cell => cell.parse().map_err(|_| self.wrong(place, "a number")),
        }
    }

    fn wrong(&self, place: Place, expected: &str) -> ImportError {
        let fix = comma_fix(self.cell(place)).unwrap_or("correct the cell or remove the row");
        self.error(place, &format!(" is not {expected}: {fix}"))
    }

    fn flag(&self, place: Place) -> Result<bool, ImportError> {
        let cell = self.cell(place);
        match cell.to_ascii_lowercase().as_str() {
            "true" => Ok(true),
            "false" => Ok(false),
            _ => match cell.parse::<f64>() {
                Ok(number) if !number.is_nan() => Ok(number != 0.0),
                _ => Err(self.wrong(place, "a number, true or false")),
            },
        }
    }
}

/// What to do about a number with a decimal comma: one program writes all of them so.
pub(super) fn comma_fix(cell: &str) -> Option<&'static str> {
    let is_number = cell.replacen(',', ".", 1).parse::<f64>().is_ok();
    (cell.contains(',') && is_number).then_some(
        "it has a decimal comma: replace those of the file, such as with `sed 's/,/./g'`",
    )
}
