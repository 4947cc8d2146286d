//! Eigenvalue maps, and the linearisation at one steady motion.

use serde_json::json;
use singletrack_analysis::stability::{Eigenvalues, StabilityError};

use super::{
    arguments::MapArgs,
    subject::{Grid, Subject, write},
};
use crate::{Result, table::Table};

pub(super) fn run(args: &MapArgs) -> Result {
    let subject = args.subject.subject()?;
    let dl = args.points.deviations_or(|| subject.usual_deviations());
    let map = eigenvalue_map(&subject, &args.points.speeds, &dl)?;
    let points: Vec<_> = map.iter().map(document).collect();
    Ok(write(
        args.format,
        &subject,
        &eigenvalue_table(&map),
        &points,
    )?)
}

/// The eigenvalues at a speed and a dl.
#[derive(Clone, Debug, PartialEq)]
pub struct EigenvalueRow {
    /// The speed, in m/s.
    pub speed: f64,
    /// The deviation dl, in m.
    pub deviation: f64,
    /// Eigenvalues by ascending real part, in 1/s.
    pub eigenvalues: Eigenvalues,
}

/// The eigenvalues over all `speeds` and, for each, all `deviations`.
///
/// # Errors
///
/// A point without a steady motion.
pub fn eigenvalue_map(
    subject: &Subject,
    speeds: &Grid,
    deviations: &Grid,
) -> Result<Vec<EigenvalueRow>, StabilityError> {
    let rows = speeds.with(deviations).map(|(speed, deviation)| {
        Ok(EigenvalueRow {
            speed,
            deviation,
            eigenvalues: subject.at(speed, deviation)?.eigenvalues(),
        })
    });
    rows.collect()
}

/// The numbers of a map.
pub fn eigenvalue_table(map: &[EigenvalueRow]) -> Table {
    let mut header = "speed_m_s,dl_m".to_owned();
    for number in 1..=map.first().map_or(0, |row| row.eigenvalues.len()) {
        header += &format!(",re{number},im{number}");
    }
    let rows = map.iter().map(|row| {
        let eigenvalues = row.eigenvalues.iter();
        [row.speed, row.deviation]
            .into_iter()
            .chain(eigenvalues.flat_map(|value| [value.re, value.im]))
            .collect()
    });
    Table {
        header,
        rows: rows.collect(),
    }
}

fn document(row: &EigenvalueRow) -> serde_json::Value {
    json!({
        "speed_m_s": row.speed,
        "dl_m": row.deviation,
        "eigenvalues_per_s": row.eigenvalues.iter().map(|value| [value.re, value.im]).collect::<Vec<_>>(),
    })
}
