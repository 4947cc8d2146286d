//! The sampled loop over speed and dl.

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use singletrack_analysis::stability::{MarginLimits, SampledLoop};

use super::{
    Format, Grid, LoopArgs, StabilityCommandError, Subject,
    output::{Table, write_json},
};

#[derive(Clone, Debug, Args)]
pub(super) struct SampledArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speeds of the steady motion, in m/s
    #[arg(
        long,
        value_name = "A:B:STEP",
        allow_hyphen_values = true,
        default_value = "0.25:5:0.25"
    )]
    speeds: Grid,
    /// Deviations dl of the centre of mass, in m [default: 21 over the meaningful range]
    #[arg(long, value_name = "A:B:STEP", allow_hyphen_values = true)]
    dl: Option<Grid>,
    #[command(flatten)]
    timing: TimingArgs,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

/// When the loop acts.
#[derive(Clone, Copy, Debug, Args)]
pub struct TimingArgs {
    /// Period of the controller, in ms
    #[arg(
        long,
        value_name = "MS",
        allow_negative_numbers = true,
        default_value_t = 10.0
    )]
    pub period_ms: f64,
    /// From a tick's measurement until its command acts, in ms
    #[arg(
        long,
        value_name = "MS",
        allow_negative_numbers = true,
        default_value_t = 10.0
    )]
    pub delay_ms: f64,
    /// Ticks from one seen pose to the next; in between it is held
    #[arg(long, value_name = "TICKS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub marker_interval: u32,
    /// Gain of a proportional position loop around the law, in 1/s; 0 for the law alone
    #[arg(
        long,
        value_name = "K",
        allow_negative_numbers = true,
        default_value_t = 0.0
    )]
    pub position_gain: f64,
}

impl Default for TimingArgs {
    fn default() -> Self {
        Self {
            period_ms: 10.0,
            delay_ms: 10.0,
            marker_interval: 1,
            position_gain: 0.0,
        }
    }
}

pub(super) fn run(args: &SampledArgs) -> Result<(), StabilityCommandError> {
    let subject = args.subject.subject()?;
    let dl = args.dl.clone().unwrap_or_else(|| {
        let range =
            singletrack_analysis::stability::ClosedLoop::meaningful_deviations(&subject.vehicle);
        Grid::spanning(range, 21)
    });
    let total = args.speeds.values().len() * dl.values().len();
    let bar = ProgressBar::new(total as u64).with_style(
        ProgressStyle::with_template("{wide_bar} {pos}/{len} points")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let map = sampled_map(&subject, &args.speeds, &dl, args.timing, || bar.inc(1))?;
    bar.finish_and_clear();
    match args.format {
        Format::Csv => Table {
            columns: vec![
                "speed_m_s",
                "dl_m",
                "spectral_radius",
                "delay_margin_s",
                "longest_marker_interval_s",
            ],
            rows: map
                .iter()
                .map(|row| {
                    vec![
                        Some(row.speed_m_s),
                        Some(row.dl_m),
                        Some(row.spectral_radius),
                        row.delay_margin_s,
                        row.longest_marker_interval_s,
                    ]
                })
                .collect(),
        }
        .write_csv()?,
        Format::Json => write_json(&subject, &map)?,
    }
    Ok(())
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

/// The sampled loop over all `speeds` and, for each, all `deviations`; tells `progress`
/// of each point.
///
/// # Errors
///
/// A point without a steady motion, or a timing that makes no sense.
pub fn sampled_map(
    subject: &Subject,
    speeds: &Grid,
    deviations: &Grid,
    timing: TimingArgs,
    mut progress: impl FnMut(),
) -> Result<Vec<SampledRow>, StabilityCommandError> {
    let mut rows = Vec::with_capacity(speeds.values().len() * deviations.values().len());
    for speed in speeds.values() {
        for deviation in deviations.values() {
            let sampled = SampledLoop::new(
                subject.at(*speed, *deviation)?,
                timing.period_ms * 1e-3,
                timing.delay_ms * 1e-3,
            )?
            .with_position_gain(timing.position_gain)?;
            let limits = MarginLimits::default();
            rows.push(SampledRow {
                speed_m_s: *speed,
                dl_m: *deviation,
                spectral_radius: sampled.spectral_radius(timing.marker_interval),
                delay_margin_s: sampled.delay_margin(limits),
                longest_marker_interval_s: sampled.longest_marker_interval(limits),
            });
            progress();
        }
    }
    Ok(rows)
}
