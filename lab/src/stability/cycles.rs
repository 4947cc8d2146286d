//! The limit cycles that are born at the Hopf points.

use clap::Args;
use serde_json::json;
use singletrack_analysis::stability::{CycleBranch, HopfPoint, LimitCycle, Saturation};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, SaturationArgs},
    figures,
    grid::Grid,
    output::write_json,
    subject::StabilityCommandError,
    subject::Subject,
};
use crate::table::Table;

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

pub(super) fn run(args: &CyclesArgs) -> Result<(), StabilityCommandError> {
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
    let cycles: Vec<LimitCycle> = branches.into_iter().flat_map(|(_, b)| b.cycles).collect();
    match args.format {
        DrawnFormat::Csv => print(&cycle_table(&cycles).to_csv())?,
        DrawnFormat::Json => {
            let points: Vec<_> = cycles.iter().map(document).collect();
            write_json(&subject, &points)?;
        }
        DrawnFormat::Svg => print(&figures::cycles(&cycles, args.speed).to_svg())?,
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
) -> Result<Vec<(HopfPoint, CycleBranch)>, StabilityCommandError> {
    let closed_loop = subject.at(speed, 0.0)?.saturating(saturation)?;
    let of = |hopf| (hopf, closed_loop.limit_cycles(&hopf, deviations.values()));
    Ok(subject.hopf_points(speed)?.into_iter().map(of).collect())
}

/// The numbers of cycles.
#[must_use]
pub fn cycle_table(cycles: &[LimitCycle]) -> Table {
    Table::of(
        cycles,
        &[
            ("dl_m", |cycle| cycle.deviation),
            ("amplitude_rad", |cycle| cycle.amplitude),
            ("period_s", |cycle| cycle.period),
            ("multiplier", |cycle| cycle.multiplier),
            ("stable", |cycle| f64::from(u8::from(cycle.is_stable()))),
        ],
    )
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

fn document(cycle: &LimitCycle) -> serde_json::Value {
    json!({
        "dl_m": cycle.deviation,
        "amplitude_rad": cycle.amplitude,
        "period_s": cycle.period,
        "multiplier": cycle.multiplier,
        "stable": cycle.is_stable(),
    })
}
