//! Rows of numbers as CSV or as JSON.

use std::io::{self, BufWriter, Write};

use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{Belief, ClosedLoop, Law};
use singletrack_scenario::csv_text::csv_text;

use super::subject::Subject;

/// A table: the names of its columns and its rows. A missing number is an empty field.
pub(super) struct Table {
    pub(super) columns: Vec<&'static str>,
    pub(super) rows: Vec<Vec<Option<f64>>>,
}

impl Table {
    pub(super) fn write_csv(&self) -> io::Result<()> {
        // The shortest text that is this number and no other.
        let cell = |value: &Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let header = self.columns.iter().map(ToString::to_string).collect();
        let rows = self.rows.iter().map(|row| row.iter().map(cell).collect());
        print_csv([header].into_iter().chain(rows))
    }
}

/// Writes rows of cells to standard output.
pub(super) fn print_csv(rows: impl IntoIterator<Item = Vec<String>>) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(csv_text(rows).as_bytes())?;
    out.flush()
}

/// Writes a document: car, law and `points`.
pub(super) fn write_json(subject: &Subject, points: &impl Serialize) -> io::Result<()> {
    let document = json!({
        "law": match subject.law {
            Law::FrontPoint => "front-point",
            Law::VelocityPoint => "velocity-point",
        },
        "wrong": match subject.belief {
            Belief::CentreOfMass => "centre-of-mass",
            Belief::FrontAxle => "front-axle",
        },
        "point_distance_m": subject.point_distance,
        "meaningful_dl_m": ClosedLoop::meaningful_deviations(&subject.vehicle),
        "vehicle": subject.vehicle,
        "points": serde_json::to_value(points).unwrap_or(Value::Null),
    });
    let mut out = BufWriter::new(io::stdout().lock());
    serde_json::to_writer_pretty(&mut out, &document)?;
    writeln!(out)?;
    out.flush()
}
