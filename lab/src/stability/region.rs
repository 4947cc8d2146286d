//! Where the steady motion is stable.

use serde::Serialize;
use singletrack_analysis::stability::StabilityError;

use super::{
    arguments::MapArgs, grid::Grid, output::write, subject::StabilityCommandError, subject::Subject,
};
use crate::table::Table;

pub(super) fn run(args: &MapArgs) -> Result<(), StabilityCommandError> {
    let subject = args.subject.subject()?;
    let dl = args.points.deviations_or(|| subject.usual_deviations());
    let region = region(&subject, &args.points.speeds, &dl)?;
    let table = Table::of(
        &region,
        &[
            ("speed_m_s", |row| row.speed_m_s),
            ("dl_m", |row| row.dl_m),
            ("largest_re_per_s", |row| row.largest_re_per_s),
            ("stable", |row| f64::from(u8::from(row.stable))),
        ],
    );
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
