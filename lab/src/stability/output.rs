//! Rows of numbers as CSV or as JSON.

use std::io;

use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::ClosedLoop;
use singletrack_figures::output::print;

use super::{arguments::Format, subject::Subject};
use crate::table::Table;

/// Writes rows as a table, or as `points` of a document.
pub(super) fn write(
    format: Format,
    subject: &Subject,
    table: &Table,
    points: &impl Serialize,
) -> io::Result<()> {
    match format {
        Format::Csv => print(&table.to_csv()),
        Format::Json => write_json(subject, points),
    }
}

/// Writes a document: car, law and `points`.
pub(super) fn write_json(subject: &Subject, points: &impl Serialize) -> io::Result<()> {
    let document = json!({
        "law": subject.law.name(),
        "wrong": subject.belief.name(),
        "point_distance_m": subject.point_distance,
        "meaningful_dl_m": ClosedLoop::meaningful_deviations(&subject.vehicle),
        "vehicle": subject.vehicle,
        "points": serde_json::to_value(points).unwrap_or(Value::Null),
    });
    print(&format!("{document:#}\n"))
}
