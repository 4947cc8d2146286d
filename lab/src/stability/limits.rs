//! The sampled loop over speed and dl, and its limits with a servo: the first unstable speed, and
//! the least p. And the one length that decides whether a car is stable without one.

use clap::Args;
use serde::Serialize;
use singletrack::progress::progress_bar;
use singletrack_analysis::stability::{
    ClosedLoop, Law, MarginLimits, OneLength, first_unstable_speed, least_point_distance,
};

use super::{
    arguments::{CarArgs, LoopArgs, PointArgs, TimingArgs},
    subject::{Format, Grid, Subject, write, write_numbers},
};
use crate::{Result, Table};

/// The searched speeds, in m/s.
pub(super) const SEARCHED_SPEEDS: [f64; 2] = [0.1, 20.0];
/// The searched distances p, in m.
pub(super) const SEARCHED_DISTANCES: [f64; 2] = [0.005, 5.0];
/// Deviations that stand for the meaningful range: with a servo its ends do not decide alone.
pub(super) const RANGE_POINTS: usize = 9;

/// Options of `first-unstable-speed`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("point_distance", |arg| arg.hide(true)))]
pub(super) struct FirstUnstableArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Distances p, in m
    #[arg(long, value_name = "A:B:STEP", default_value = "0.05:0.5:0.05")]
    distances: Grid,
    /// Deviations dl of the centre of mass, in m
    #[arg(long, value_name = "A:B:STEP", default_value = "0")]
    dl: Grid,
    #[command(flatten)]
    servo: ServoArgs,
}

/// Options of `least-p`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("point_distance", |arg| arg.hide(true)))]
pub(super) struct LeastArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speeds of the steady motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.25:5:0.25")]
    speeds: Grid,
    /// Deviations dl of the centre of mass that must all be stable, in m
    #[arg(long, value_name = "A:B:STEP", default_value = "0")]
    dl: Grid,
    #[command(flatten)]
    servo: ServoArgs,
}

/// The timing with the servo of the simulated car, and how to write the result.
#[derive(Clone, Debug, Args)]
#[command(
    mut_arg("delay_ms", |arg| arg.default_value("7")),
    mut_arg("steering_lag_ms", |arg| arg.default_value("40")),
    mut_arg("steering_dead_time_ms", |arg| arg.default_value("2")),
    mut_arg("servo_frame", |arg| arg.default_value("2")),
    mut_arg("yaw_rate_age_ms", |arg| arg.default_value("5")),
    mut_arg("predicted_ticks", |arg| arg.default_value("2")),
)]
struct ServoArgs {
    /// Delays from tick to servo, in ms [default: the one of --delay-ms]
    #[arg(long, value_name = "A:B:STEP")]
    delays_ms: Option<Grid>,
    #[command(flatten)]
    timing: TimingArgs,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

impl ServoArgs {
    /// The timing with each of the delays, or with its own.
    fn timings(&self) -> Vec<TimingArgs> {
        let own = [self.timing.delay_ms];
        let delays = self.delays_ms.as_ref().map_or(&own[..], Grid::values);
        let timings = delays.iter().map(|delay_ms| TimingArgs {
            delay_ms: *delay_ms,
            ..self.timing
        });
        timings.collect()
    }
}

pub(super) fn run_first_unstable(args: &FirstUnstableArgs) -> Result {
    let subject = args.subject.subject()?;
    let mut rows = Vec::new();
    for p in args.distances.values() {
        for dl in args.dl.values() {
            for timing in args.servo.timings() {
                let first = first_unstable(&subject, timing, &[*dl], *p)?;
                // A limit that the search has not found is missing.
                let first = first.unwrap_or(f64::NAN);
                rows.push(vec![*p, *dl, timing.delay_ms, first]);
            }
        }
    }
    let header = "point_distance_m,dl_m,delay_ms,first_unstable_m_s";
    Ok(write_numbers(args.servo.format, &subject, header, rows)?)
}

pub(super) fn run_least(args: &LeastArgs) -> Result {
    let subject = args.subject.subject()?;
    let mut rows = Vec::new();
    for speed in args.speeds.values() {
        for timing in args.servo.timings() {
            let least = least_p(&subject, timing, args.dl.values(), *speed)?;
            rows.push(vec![*speed, timing.delay_ms, least.unwrap_or(f64::NAN)]);
        }
    }
    let header = "speed_m_s,delay_ms,least_p_m";
    Ok(write_numbers(args.servo.format, &subject, header, rows)?)
}

/// The lowest speed in m/s from which the motion is unstable with one of `deviations` (m) and
/// P at `point_distance` (m). None up to 20 m/s.
///
/// # Errors
///
/// A car without a steady motion, or an invalid timing.
pub fn first_unstable(
    subject: &Subject,
    timing: TimingArgs,
    deviations: &[f64],
    point_distance: f64,
) -> Result<Option<f64>> {
    let at = subject
        .at(SEARCHED_SPEEDS[0], 0.0)?
        .with_point_distance(point_distance)?;
    let sampled = timing.around(at)?;
    Ok(first_unstable_speed(&sampled, deviations, SEARCHED_SPEEDS)?)
}

/// The least p in m that is stable at `speed` (m/s) with each of `deviations` (m). None up to
/// 5 m.
///
/// # Errors
///
/// A car without a steady motion, or an invalid timing.
pub fn least_p(
    subject: &Subject,
    timing: TimingArgs,
    deviations: &[f64],
    speed: f64,
) -> Result<Option<f64>> {
    let sampled = timing.around(subject.at(speed, 0.0)?)?;
    Ok(least_point_distance(
        &sampled,
        deviations,
        SEARCHED_DISTANCES,
    )?)
}

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

pub(super) fn run(args: &SampledArgs) -> Result {
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
) -> Result<Vec<SampledRow>> {
    let total = speeds.values().len() * deviations.values().len();
    let bar = progress_bar(
        total as u64,
        &format!("{{wide_bar}} {{pos}}/{{len}} {what}"),
    );
    let map = sampled_map(subject, speeds, deviations, timing, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(map)
}

/// The numbers of a map; of a margin that was not found none.
pub fn sampled_table(map: &[SampledRow]) -> Table {
    let header = "speed_m_s,dl_m,spectral_radius,delay_margin_s,longest_constant_interval_s";
    Table::of(header, map)
}

/// The sampled loop at a speed and a dl.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampledRow {
    /// The speed, in m/s.
    pub speed_m_s: f64,
    /// The deviation dl, in m.
    pub dl_m: f64,
    /// The factor by which disturbances grow or decay per tick in the long run.
    pub spectral_radius: f64,
    /// The smallest delay that makes it unstable; none if no delay up to 0.5 s does.
    pub delay_margin_s: Option<f64>,
    /// The longest survivable time between poses; none if 200 ticks are survived.
    pub longest_constant_interval_s: Option<f64>,
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
) -> Result<Vec<SampledRow>> {
    let limits = MarginLimits::default();
    let rows = speeds.with(deviations).map(|(speed_m_s, dl_m)| {
        let sampled = timing.around(subject.at(speed_m_s, dl_m)?)?;
        let row = SampledRow {
            speed_m_s,
            dl_m,
            spectral_radius: sampled.spectral_radius(),
            delay_margin_s: sampled.delay_margin(limits),
            longest_constant_interval_s: sampled.longest_constant_interval(limits),
        };
        progress();
        Ok(row)
    });
    rows.collect()
}

/// Options of `one-length`.
#[derive(Clone, Debug, Args)]
pub(super) struct OneLengthArgs {
    #[command(flatten)]
    car: CarArgs,
    /// Speeds up to which the car is to be stable, in m/s; inf for every speed
    #[arg(long, value_name = "A:B:STEP", default_value = "1,2,3,5,inf", value_parser = speeds)]
    speeds: Speeds,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

#[derive(Clone, Debug)]
struct Speeds(Vec<f64>);

fn speeds(text: &str) -> Result<Speeds, String> {
    let (text, is_endless) = match text.strip_suffix("inf") {
        Some(rest) => (rest.trim_end_matches(','), true),
        None => (text, false),
    };
    let mut speeds = match text {
        "" if is_endless => Vec::new(),
        text => text.parse::<Grid>()?.values().to_vec(),
    };
    speeds.extend(is_endless.then_some(f64::INFINITY));
    Ok(Speeds(speeds))
}

pub(super) fn run_one_length(args: &OneLengthArgs) -> Result {
    let subject = args.car.under(Law::FrontPoint)?;
    let range = ClosedLoop::meaningful_deviations(&subject.vehicle);
    let or_none = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let mut rows = Vec::new();
    for speed in &args.speeds.0 {
        let length = OneLength::of(subject.vehicle, *speed)?;
        let endless = length.distances.iter().find(|[_, to]| to.is_infinite());
        let other = length.distances.iter().find(|[_, to]| to.is_finite());
        let mut bounds = Vec::new();
        if speed.is_finite() {
            for dl in Grid::spanning(range, 41).values() {
                bounds.push(subject.at(*speed, *dl)?.actuation_bound());
            }
        }
        let bounds: Option<Vec<f64>> = bounds.into_iter().collect();
        let least = bounds.and_then(|bounds| bounds.into_iter().min_by(f64::total_cmp));
        rows.push(vec![
            *speed,
            or_none(endless.map(|[from, _]| *from)),
            or_none(other.map(|[from, _]| *from)),
            or_none(other.map(|[_, to]| *to)),
            or_none(least),
        ]);
    }
    let header = "speed_m_s,p_from_m,other_from_m,other_to_m,actuation_s";
    Ok(write_numbers(args.format, &subject, header, rows)?)
}
