//! What a desk needs and a car does not: stability, identification, the reproduction of the paper's
//! experiments, the comparison of controllers, and the judgement of logs.

#![allow(
    clippy::disallowed_methods,
    reason = "figures and tables; the modules that plan simulated drives forbid it"
)]

pub mod benchmark;
pub mod compare;
pub mod identify;
pub mod judge;
pub mod program;
pub mod reproduce;
pub mod stability;
pub mod vehicle_file;

use serde::Serialize;
use serde_json::{Map, Value, json};
use singletrack_scenario::csv_text::csv_text;

pub use singletrack_campaign::Result;

/// How to print a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// For a person.
    #[value(alias = "text")]
    Table,
    /// For a program: one JSON object, with every digit.
    Json,
}

/// Columns of numbers; what is not a number is missing.
#[derive(Clone, Debug)]
pub struct Table {
    /// The names of the columns, separated by commas, with their units.
    pub header: String,
    /// The rows.
    pub rows: Vec<Vec<f64>>,
}

impl Table {
    /// The columns with these names, separated by commas: fields of the rows. A truth is 1 or 0.
    pub fn of(header: &str, rows: &[impl Serialize]) -> Self {
        let number = |value: &Value| match value {
            Value::Bool(is) => f64::from(u8::from(*is)),
            value => value.as_f64().unwrap_or(f64::NAN),
        };
        let row = |row| {
            let fields = json!(row);
            let names = header.split(',');
            names.map(|name| number(&fields[name])).collect()
        };
        Self {
            header: header.to_owned(),
            rows: rows.iter().map(row).collect(),
        }
    }

    /// The table as JSON: an object for each row, with null for a number that is missing.
    pub fn to_json(&self) -> Vec<Map<String, Value>> {
        let object = |row: &Vec<f64>| {
            let names = self.header.split(',').map(str::to_owned);
            names.zip(row.iter().map(|value| json!(value))).collect()
        };
        self.rows.iter().map(object).collect()
    }

    /// The table as CSV: numbers with every significant digit; an empty cell for one that is missing.
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

/// Prints a text as it is.
fn print(text: &str) -> Result {
    singletrack_figures::output::print(text)
        .map_err(|error| format!("can't write to standard output: {error}").into())
}
