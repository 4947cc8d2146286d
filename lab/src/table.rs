//! Tables of numbers.

use serde_json::{Map, Value, json};
use singletrack_scenario::csv_text::csv_text;

/// Columns of numbers; what is not a number is missing.
#[derive(Clone, Debug)]
pub struct Table {
    /// The names of the columns, separated by commas, with their units.
    pub header: String,
    /// The rows.
    pub rows: Vec<Vec<f64>>,
}

/// The name of a column, and its value in a row.
pub type Column<'a, R> = (&'a str, fn(&R) -> f64);

impl Table {
    /// The columns of some rows.
    pub fn of<R>(rows: &[R], columns: &[Column<'_, R>]) -> Self {
        let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
        let values = |row| columns.iter().map(|(_, value)| value(row)).collect();
        Self {
            header: names.join(","),
            rows: rows.iter().map(values).collect(),
        }
    }

    /// As JSON: an object for each row, with null for a number that is missing.
    pub fn to_json(&self) -> Vec<Map<String, Value>> {
        let object = |row: &Vec<f64>| {
            let names = self.header.split(',').map(str::to_owned);
            names.zip(row.iter().map(|value| json!(value))).collect()
        };
        self.rows.iter().map(object).collect()
    }

    /// As CSV: numbers with every significant digit; an empty cell for one that is missing.
    pub fn to_csv(&self) -> String {
        let cell = |value: &f64| {
            if value.is_nan() {
                String::new()
            } else {
                value.to_string()
            }
        };
        let rows = self.rows.iter();
        let rows = rows.map(|row| row.iter().map(cell).collect::<Vec<String>>());
        format!("{}\n{}", self.header, csv_text(rows))
    }
}
