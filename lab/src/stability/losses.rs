//! The sampled loop when poses are lost: irregular intervals, and random bursts.

use std::{fs, path::PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{
    LyapunovFunction, MarginLimits, RandomLosses, SampledLoop, SamplingError, Switched,
};

use super::{
    arguments::{LoopArgs, PointArgs, TimingArgs},
    subject::{Format, Grid, Subject, write, write_numbers},
};
use crate::{Result, Table};

/// Options of `losses`.
#[derive(Clone, Debug, Args)]
#[command(
    mut_arg("speeds", |speeds| speeds.default_value("1:5:1")),
    mut_arg("dl", |dl| dl.default_value("0").help("Deviations dl of the centre of mass, in m")),
    mut_arg("marker_interval", |arg| arg.hide(true)),
)]
pub(super) struct LossesArgs {
    #[command(flatten)]
    subject: LoopArgs,
    #[command(flatten)]
    points: PointArgs,
    #[command(flatten)]
    timing: TimingArgs,
    /// The longest interval between poses that is looked at, in ms
    #[arg(long, value_name = "MS", default_value_t = 2000.0)]
    longest_ms: f64,
    /// Losses at random, in bursts of these mean lengths: up to which share of lost poses the motion
    /// is stable in the mean square
    #[arg(long, value_name = "A:B:STEP")]
    bursts_ms: Option<Grid>,
    /// Write the Lyapunov functions that prove it, as JSON
    #[arg(long, value_name = "FILE")]
    certificates: Option<PathBuf>,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

pub(super) fn run(args: &LossesArgs) -> Result {
    let subject = args.subject.subject()?;
    let timing = TimingArgs {
        marker_interval: 1,
        ..args.timing
    };
    let dl = args.points.deviations_or(|| Grid::spanning([0.0; 2], 1));
    let mut proofs = args.certificates.as_ref().map(|_| Vec::new());
    let mut points = Vec::new();
    for (speed_m_s, dl_m) in args.points.speeds.with(&dl) {
        let at = subject.at(speed_m_s, dl_m)?;
        points.push(Point {
            subject: &subject,
            timing: &timing,
            speed_m_s,
            dl_m,
            sampled: timing.around(at)?,
        });
    }
    match &args.bursts_ms {
        None => {
            let ticks = (args.longest_ms / timing.period_ms).round();
            if !(1.0..=1_000.0).contains(&ticks) {
                return Err(SamplingError {
                    name: "--longest-ms in control periods",
                    value: ticks,
                    rule: "between 1 and 1000",
                }
                .into());
            }
            let limit = ticks as u32;
            let rows: Vec<IrregularRow> = points
                .iter()
                .map(|point| irregular(point, limit, proofs.as_mut()))
                .collect();
            let header = "speed_m_s,dl_m,every_pattern_s,constant_s,unstable_short_s,shorts,\
                          unstable_long_s,longs,growth";
            write(args.format, &subject, &Table::of(header, &rows), &rows)?;
        }
        Some(bursts) => {
            let mut rows = Vec::new();
            for point in &points {
                for burst_ms in bursts.values() {
                    rows.push(random(point, *burst_ms, proofs.as_mut()));
                }
            }
            let header = "speed_m_s,dl_m,burst_s,largest_share";
            write_numbers(args.format, &subject, header, rows)?;
        }
    }
    if let (Some(path), Some(proofs)) = (&args.certificates, proofs) {
        let text = format!("{:#}\n", json!({ "certificates": proofs }));
        fs::write(path, text)?;
    }
    Ok(())
}

/// A loop that is looked at.
struct Point<'a> {
    subject: &'a Subject,
    timing: &'a TimingArgs,
    speed_m_s: f64,
    dl_m: f64,
    sampled: SampledLoop,
}

/// Irregular intervals between poses that a motion survives.
#[derive(Clone, Copy, Debug, Serialize)]
struct IrregularRow {
    speed_m_s: f64,
    dl_m: f64,
    /// Every pattern of intervals up to this one is stable.
    every_pattern_s: f64,
    /// If poses come in this interval only, up to which it is stable.
    constant_s: Option<f64>,
    /// The known unstable pattern with the shortest long interval: `shorts` short intervals, then `longs`
    /// long ones.
    unstable_short_s: Option<f64>,
    shorts: Option<u32>,
    unstable_long_s: Option<f64>,
    longs: Option<u32>,
    /// The factor by which the motion grows over that pattern.
    growth: Option<f64>,
}

fn irregular(point: &Point<'_>, limit: u32, proofs: Option<&mut Vec<Value>>) -> IrregularRow {
    let period = point.timing.period_ms * 1e-3;
    let seconds = |ticks: u32| (f64::from(ticks) * period * 1e6).round() / 1e6;
    let limits = point.sampled.irregular_limits(limit);
    if let Some(proofs) = proofs.filter(|_| limits.proved > 0) {
        let claim = json!({ "every_pattern_up_to_ticks": limits.proved });
        let switched = point.sampled.irregular(limits.proved);
        let function = switched.common_function();
        proofs.extend(function.map(|function| certificate(point, &claim, &switched, &function)));
    }
    let unstable = limits.unstable;
    IrregularRow {
        speed_m_s: point.speed_m_s,
        dl_m: point.dl_m,
        every_pattern_s: seconds(limits.proved),
        constant_s: point.sampled.longest_constant_interval(MarginLimits {
            marker_interval: limit,
            ..MarginLimits::default()
        }),
        unstable_short_s: unstable.map(|pattern| seconds(pattern.short)),
        shorts: unstable.map(|pattern| pattern.shorts),
        unstable_long_s: unstable.map(|pattern| seconds(pattern.long)),
        longs: unstable.map(|pattern| pattern.longs),
        growth: unstable.map(|pattern| pattern.growth),
    }
}

/// The resolution of the share, and how far below its end it is looked at.
const SHARE_RESOLUTION: f64 = 1e-4;

fn random(point: &Point<'_>, burst_ms: f64, proofs: Option<&mut Vec<Value>>) -> Vec<f64> {
    let mean_ticks = (burst_ms / point.timing.period_ms).max(1.0);
    let at = |share| {
        let losses = RandomLosses { share, mean_ticks };
        point.sampled.with_random_losses(losses)
    };
    let is_stable = |share: f64| at(share).mean_square_function().is_some();
    // A single pose between two bursts is the most that can be lost.
    let most = mean_ticks / (mean_ticks + 1.0) - SHARE_RESOLUTION;
    let largest_share = (!is_stable(most)).then(|| {
        let (mut stable, mut unstable) = (0.0, most);
        while unstable - stable > SHARE_RESOLUTION {
            let middle = 0.5 * (stable + unstable);
            if is_stable(middle) {
                stable = middle;
            } else {
                unstable = middle;
            }
        }
        stable
    });
    if let Some(proofs) = proofs {
        let share = largest_share.unwrap_or(most);
        let claim = json!({ "mean_square": { "share": share, "mean_ticks": mean_ticks } });
        let switched = at(share);
        let function = switched.mean_square_function();
        proofs.extend(function.map(|function| certificate(point, &claim, &switched, &function)));
    }
    vec![
        point.speed_m_s,
        point.dl_m,
        mean_ticks * point.timing.period_ms * 1e-3,
        largest_share.unwrap_or(f64::NAN),
    ]
}

/// All that a program needs which derives the loop for itself, and checks that the functions fall.
fn certificate(
    point: &Point<'_>,
    claim: &Value,
    switched: &Switched,
    function: &LyapunovFunction,
) -> Value {
    let timing = point.timing;
    let rows = |matrix: &nalgebra::DMatrix<f64>| -> Vec<Vec<f64>> {
        let rows = matrix.row_iter();
        rows.map(|row| row.iter().copied().collect()).collect()
    };
    json!({
        "claim": claim,
        "law": point.subject.law.name(),
        "wrong": point.subject.belief.name(),
        "vehicle": point.subject.vehicle,
        "point_distance_m": point.subject.point_distance,
        "speed_m_s": point.speed_m_s,
        "dl_m": point.dl_m,
        "period_ms": timing.period_ms,
        "delay_ms": timing.delay_ms,
        "position_gain_per_s": timing.position_gain,
        "steering_lag_ms": timing.steering_lag_ms,
        "steering_dead_time_ms": timing.steering_dead_time_ms,
        "yaw_rate_age_ms": timing.yaw_rate_age_ms,
        "sideslip_age_ms": timing.sideslip_age_ms,
        "predicted_ticks": timing.predicted_ticks,
        "servo_frame": timing.servo_frame,
        "compensate": timing.compensate,
        "predict": timing.predict,
        "coordinates": switched.coordinates,
        "functions": function.0.iter().map(rows).collect::<Vec<_>>(),
    })
}
