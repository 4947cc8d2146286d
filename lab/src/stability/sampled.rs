//! The sampled loop over speed and dl.

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use singletrack_analysis::stability::{ClosedLoop, MarginLimits};

use super::{
    arguments::{Format, LoopArgs, PointArgs, TimingArgs},
    grid::Grid,
    output::write,
    subject::StabilityCommandError,
    subject::Subject,
};
use crate::table::Table;

#[derive(Clone, Debug, Args)]
#[command(
    mut_arg("speeds", |speeds| speeds.default_value("0.25:5:0.25")),
    mut_arg("dl", |dl| {
        dl.help(
            "Deviations dl of the centre of mass, in m [default: 21 over the meaningful range]",
        )
    })
)]
pub(super) struct SampledArgs {
    #[command(flatten)]
    subject: LoopArgs,
    #[command(flatten)]
    points: PointArgs,
    #[command(flatten)]
    timing: TimingArgs,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

pub(super) fn run(args: &SampledArgs) -> Result<(), StabilityCommandError> {
    let subject = args.subject.subject()?;
    let dl = args
        .points
        .deviations_or(|| Grid::spanning(ClosedLoop::meaningful_deviations(&subject.vehicle), 21));
    let map = shown_map(&subject, &args.points.speeds, &dl, args.timing, "points")?;
    Ok(write(args.format, &subject, &sampled_table(&map), &map)?)
}

/// [`sampled_map`] with progress on a terminal: how many of `what` are done.
pub(super) fn shown_map(
    subject: &Subject,
    speeds: &Grid,
    deviations: &Grid,
    timing: TimingArgs,
    what: &str,
) -> Result<Vec<SampledRow>, StabilityCommandError> {
    let total = speeds.values().len() * deviations.values().len();
    let bar = ProgressBar::new(total as u64);
    if let Ok(style) = ProgressStyle::with_template(&format!("{{wide_bar}} {{pos}}/{{len}} {what}"))
    {
        bar.set_style(style);
    }
    let map = sampled_map(subject, speeds, deviations, timing, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(map)
}

/// The numbers of a map; of a margin that was not found none.
#[must_use]
pub fn sampled_table(map: &[SampledRow]) -> Table {
    Table::of(
        map,
        &[
            ("speed_m_s", |row| row.speed_m_s),
            ("dl_m", |row| row.dl_m),
            ("spectral_radius", |row| row.spectral_radius),
            ("delay_margin_s", |row| {
                row.delay_margin_s.unwrap_or(f64::NAN)
            }),
            ("longest_marker_interval_s", |row| {
                row.longest_marker_interval_s.unwrap_or(f64::NAN)
            }),
        ],
    )
}

/// The sampled loop at a speed and a dl.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampledRow {
    /// The speed, in m/s.
    pub speed_m_s: f64,
    /// The deviation dl, in m.
    pub dl_m: f64,
    /// By which disturbances grow or decay per tick in the long run.
    pub spectral_radius: f64,
    /// The smallest delay that makes it unstable; none if no delay up to 0.5 s does.
    pub delay_margin_s: Option<f64>,
    /// The longest survivable time between poses; none if 200 ticks are survived.
    pub longest_marker_interval_s: Option<f64>,
}

/// The sampled loop over all `speeds` and, for each, all `deviations`; calls
/// `progress` after each point.
///
/// # Errors
///
/// A point without a steady motion, or an invalid timing.
pub fn sampled_map(
    subject: &Subject,
    speeds: &Grid,
    deviations: &Grid,
    timing: TimingArgs,
    mut progress: impl FnMut(),
) -> Result<Vec<SampledRow>, StabilityCommandError> {
    let limits = MarginLimits::default();
    let rows = speeds.with(deviations).map(|(speed_m_s, dl_m)| {
        let sampled = timing.around(subject.at(speed_m_s, dl_m)?)?;
        let row = SampledRow {
            speed_m_s,
            dl_m,
            spectral_radius: sampled.spectral_radius(),
            delay_margin_s: sampled.delay_margin(limits),
            longest_marker_interval_s: sampled.longest_marker_interval(limits),
        };
        progress();
        Ok(row)
    });
    rows.collect()
}
