//! Rows of a log: lines of a CSV file, or messages of a bag.

use super::{log::ImportError, map::Messages};

/// The place of a column in the rows of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Which rows have the column: of a bag, those of one section of the map; of CSV files, those of one
    /// file.
    pub(super) source: usize,
    /// The column in these rows.
    pub(super) index: usize,
}

/// The columns of a log.
pub(super) trait Header {
    /// The place of the column, or the field of the section's messages, that `key` in the map names.
    fn find(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &str,
    ) -> Result<Place, ImportError>;

    /// [`find`](Self::find) for a key that may be left out.
    fn find_if(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &Option<String>,
    ) -> Result<Option<Place>, ImportError> {
        let column = column.as_ref();
        column
            .map(|column| self.find(key, messages, column))
            .transpose()
    }
}

/// A value in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cell<'a> {
    Empty,
    Number(f64),
    /// A text as a file has it, which may be a number.
    Text(&'a str),
}

impl<'a> Cell<'a> {
    /// The cell with this text.
    pub(super) const fn of(text: &'a str) -> Self {
        if text.is_empty() {
            Self::Empty
        } else {
            Self::Text(text)
        }
    }

    /// The value as text, to compare it with that of another row.
    pub(super) fn text(self) -> String {
        match self {
            Self::Empty => String::new(),
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.to_owned(),
        }
    }
}

/// A row of a log.
pub(super) trait Row {
    /// Whether the row has a column at this place.
    fn has(&self, place: Place) -> bool;

    /// The value at this place.
    fn cell(&self, place: Place) -> Cell<'_>;

    /// The error of a value that is not what is expected.
    fn wrong(&self, place: Place, expected: &str) -> ImportError;

    /// A number, which need not be finite; not a number where there is no value.
    fn number(&self, place: Place) -> Result<f64, ImportError> {
        match self.cell(place) {
            Cell::Empty => Ok(f64::NAN),
            Cell::Number(number) => Ok(number),
            Cell::Text(text) => text.parse().map_err(|_| self.wrong(place, "a number")),
        }
    }

    /// A finite number.
    fn finite(&self, place: Place) -> Result<f64, ImportError> {
        let number = self.number(place)?;
        match number.is_finite() {
            true => Ok(number),
            false => Err(self.wrong(place, "a finite number")),
        }
    }

    /// Whether a value is neither 0 nor `false`.
    fn flag(&self, place: Place) -> Result<bool, ImportError> {
        let number = match self.cell(place) {
            Cell::Text(text) if text.eq_ignore_ascii_case("true") => Ok(1.0),
            Cell::Text(text) if text.eq_ignore_ascii_case("false") => Ok(0.0),
            _ => self.number(place),
        };
        match number {
            Ok(number) if !number.is_nan() => Ok(number != 0.0),
            _ => Err(self.wrong(place, "a number, true or false")),
        }
    }

    /// Whether there is no value at any of these places.
    fn are_empty<const N: usize>(&self, places: [Place; N]) -> bool {
        let mut cells = places.iter().map(|place| self.cell(*place));
        cells.all(|cell| cell == Cell::Empty)
    }
}
