//! The steady motion over speed and dl: where it is stable, and its eigenvalues.

use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{Eigenvalues, StabilityError};

use super::{
    arguments::MapArgs,
    subject::{Grid, Subject, write},
};
use crate::{Result, table::Table};

pub(super) fn run(args: &MapArgs) -> Result {
    let subject = args.subject.subject()?;
    let dl = args.points.deviations_or(|| subject.usual_deviations());
    let region = region(&subject, &args.points.speeds, &dl)?;
    let table = Table::of("speed_m_s,dl_m,largest_re_per_s,stable", &region);
    Ok(write(args.format, &subject, &table, &region)?)
}

/// Whether the steady motion is stable at a speed and a dl.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RegionRow {
    /// The speed, in m/s.
    pub speed_m_s: f64,
    /// The deviation dl, in m.
    pub dl_m: f64,
    /// The largest real part of an eigenvalue, in 1/s.
    pub largest_re_per_s: f64,
    /// Whether it is asymptotically stable, by Hurwitz' criterion.
    pub stable: bool,
}

/// Stability over all `speeds` and, for each, all `deviations`.
///
/// # Errors
///
/// A point without a steady motion.
pub fn region(
    subject: &Subject,
    speeds: &Grid,
    deviations: &Grid,
) -> Result<Vec<RegionRow>, StabilityError> {
    let rows = speeds.with(deviations).map(|(speed_m_s, dl_m)| {
        let at = subject.at(speed_m_s, dl_m)?;
        let largest = at.eigenvalues().last().map(|value| value.re);
        Ok(RegionRow {
            speed_m_s,
            dl_m,
            largest_re_per_s: largest.unwrap_or(f64::NAN),
            stable: at.is_stable(),
        })
    });
    rows.collect()
}

pub(super) fn run_eigenvalues(args: &MapArgs) -> Result {
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

fn document(row: &EigenvalueRow) -> Value {
    json!({
        "speed_m_s": row.speed,
        "dl_m": row.deviation,
        "eigenvalues_per_s": row.eigenvalues.iter().map(|value| [value.re, value.im]).collect::<Vec<_>>(),
    })
}
