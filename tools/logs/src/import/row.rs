//! Rows of a log: lines of a CSV file, or messages of a bag.

use std::borrow::Cow;

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

    /// As [`find`](Self::find), of a key that may be left out.
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

/// A row of a log.
pub(super) trait Row {
    /// Whether the row has a column at this place.
    fn has(&self, place: Place) -> bool;

    /// Whether there is no value.
    fn is_empty(&self, place: Place) -> bool;

    /// The value as text, to compare it with that of another row.
    fn text(&self, place: Place) -> Cow<'_, str>;

    /// A number, which need not be finite; not a number where there is no value.
    fn number(&self, place: Place) -> Result<f64, ImportError>;

    /// The error of a value that is not what is expected.
    fn wrong(&self, place: Place, expected: &str) -> ImportError;

    /// A finite number.
    fn finite(&self, place: Place) -> Result<f64, ImportError> {
        let number = self.number(place)?;
        match number.is_finite() {
            true => Ok(number),
            false => Err(self.wrong(place, "a finite number")),
        }
    }

    /// Whether a value is neither 0 nor `false`.
    fn flag(&self, place: Place) -> Result<bool, ImportError>;

    /// Whether there is no value at any of these places.
    fn are_empty<const N: usize>(&self, places: [Place; N]) -> bool {
        places.iter().all(|place| self.is_empty(*place))
    }
}
