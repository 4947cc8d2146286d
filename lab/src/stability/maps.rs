//! The steady motion over speed and dl: where it is stable, and its eigenvalues; the Hopf curve, where
//! stability ends, speed by speed; and the limit cycles born there.

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{
    CycleBranch, Eigenvalues, HopfPoint, LimitCycle, Saturation, StabilityError,
};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, MapArgs, SaturationArgs},
    figures::{self, Scene},
    subject::{Grid, Subject, write, write_json},
};
use crate::{Result, Table};

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

#[derive(Clone, Debug, Args)]
pub(super) struct HopfArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speeds of the steady motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.1:8:0.05")]
    speeds: Grid,
    /// How to write them
    #[arg(long, value_enum, default_value_t = DrawnFormat::Csv)]
    format: DrawnFormat,
}

pub(super) fn run_hopf(args: &HopfArgs) -> Result {
    let subject = args.subject.subject()?;
    let curve = hopf_curve(&subject, &args.speeds)?;
    if curve.is_empty() {
        eprintln!("singletrack: there is no Hopf point at these speeds, for any dl");
    }
    match args.format {
        DrawnFormat::Csv => print(&hopf_table(&curve).to_csv())?,
        DrawnFormat::Json => write_json(&subject, &hopf_documents(&curve))?,
        DrawnFormat::Svg => {
            let deviations = figures::drawn_deviations(&subject, 241);
            let region = region(&subject, &args.speeds, &deviations)?;
            let figure = figures::region(&Scene::new(&subject, &curve)?, &region)?;
            print(&figure.to_svg())?;
        }
    }
    Ok(())
}

/// The Hopf points of all `speeds`, by speed and then by dl.
///
/// # Errors
///
/// A speed or a car without a steady motion.
pub fn hopf_curve(subject: &Subject, speeds: &Grid) -> Result<Vec<HopfPoint>, StabilityError> {
    let points = speeds.values().iter();
    let points = points.map(|speed| subject.hopf_points(*speed));
    Ok(points.collect::<Result<Vec<_>, _>>()?.concat())
}

/// The numbers of Hopf points.
pub fn hopf_table(curve: &[HopfPoint]) -> Table {
    let header = "speed_m_s,dl_hopf_m,omega_rad_s,l1_kuznetsov,l1_matcont";
    Table::of(header, &hopf_documents(curve))
}

fn hopf_documents(curve: &[HopfPoint]) -> Vec<Value> {
    let document = |point: &HopfPoint| {
        json!({
            "speed_m_s": point.speed,
            "dl_hopf_m": point.deviation,
            "omega_rad_s": point.angular_frequency,
            "l1_kuznetsov": point.lyapunov.kuznetsov,
            "l1_matcont": point.lyapunov.matcont,
            "criticality": point.criticality().name(),
            "dre_ddl_per_s_m": point.crossing,
            "largest_other_re_per_s": point.largest_other_real_part,
            "ends_stability": point.ends_stability(),
        })
    };
    curve.iter().map(document).collect()
}

#[derive(Clone, Debug, Args)]
pub(super) struct CyclesArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speed of the straight motion, in m/s
    #[arg(long, value_name = "M_S")]
    speed: f64,
    /// Deviations dl of the centre of mass, in m [default: those of the paper's figures]
    #[arg(long, value_name = "A:B:STEP")]
    dl: Option<Grid>,
    #[command(flatten)]
    saturation: SaturationArgs,
    /// How to write them
    #[arg(long, value_enum, default_value_t = DrawnFormat::Csv)]
    format: DrawnFormat,
}

pub(super) fn run_cycles(args: &CyclesArgs) -> Result {
    let subject = args.subject.subject()?;
    let dl = args
        .dl
        .clone()
        .unwrap_or_else(|| subject.usual_deviations());
    let saturation = args.saturation.saturation();
    let branches = limit_cycles(&subject, args.speed, &dl, saturation)?;
    if branches.is_empty() {
        eprintln!("singletrack: there is no Hopf point at this speed, for any dl");
    }
    for (hopf, branch) in &branches {
        describe(hopf, branch);
    }
    let hopf: Vec<HopfPoint> = branches.iter().map(|(hopf, _)| *hopf).collect();
    let cycles: Vec<LimitCycle> = branches.into_iter().flat_map(|(_, b)| b.cycles).collect();
    let points: Vec<_> = cycles.iter().map(cycle_document).collect();
    let header = "dl_m,amplitude_rad,period_s,multiplier,stable";
    match args.format {
        DrawnFormat::Csv => print(&Table::of(header, &points).to_csv())?,
        DrawnFormat::Json => write_json(&subject, &points)?,
        DrawnFormat::Svg => print(&figures::cycles(&cycles, &hopf, args.speed).to_svg())?,
    }
    Ok(())
}

/// The branches of all Hopf points at a speed (m/s), with their cycles at `deviations`.
///
/// # Errors
///
/// A speed or a car without a steady motion, or a limit that is not above zero.
pub fn limit_cycles(
    subject: &Subject,
    speed: f64,
    deviations: &Grid,
    saturation: Saturation,
) -> Result<Vec<(HopfPoint, CycleBranch)>> {
    let closed_loop = subject.at(speed, 0.0)?.saturating(saturation)?;
    let of = |hopf| (hopf, closed_loop.limit_cycles(&hopf, deviations.values()));
    Ok(subject.hopf_points(speed)?.into_iter().map(of).collect())
}

/// Where a branch begins, turns back and ends, to standard error.
fn describe(hopf: &HopfPoint, branch: &CycleBranch) {
    let at = |cycle: &LimitCycle| {
        format!(
            "dl = {:.6} m, {:.4} rad, {:.4} s",
            cycle.deviation, cycle.amplitude, cycle.period
        )
    };
    let end = match &branch.last {
        None => ", of which no cycle can be computed".to_owned(),
        Some(_) if branch.is_out_of_range => ", leaves the range of dl".to_owned(),
        Some(last) => format!(", can't be followed beyond {}", at(last)),
    };
    let folds: String = branch
        .folds
        .iter()
        .map(|fold| format!(", fold at {}", at(fold)))
        .collect();
    eprintln!(
        "singletrack: branch from dl = {:.6} m{folds}{end}",
        hopf.deviation
    );
}

fn cycle_document(cycle: &LimitCycle) -> Value {
    json!({
        "dl_m": cycle.deviation,
        "amplitude_rad": cycle.amplitude,
        "period_s": cycle.period,
        "multiplier": cycle.multiplier,
        "stable": cycle.is_stable(),
    })
}
