//! The Hopf curve: where stability ends, speed by speed.

use clap::Args;
use serde_json::json;
use singletrack_analysis::stability::{HopfPoint, StabilityError};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs},
    figures::{self, Scene},
    grid::Grid,
    output::write_json,
    region::region,
    subject::StabilityCommandError,
    subject::Subject,
};
use crate::table::Table;

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

pub(super) fn run(args: &HopfArgs) -> Result<(), StabilityCommandError> {
    let subject = args.subject.subject()?;
    let curve = hopf_curve(&subject, &args.speeds)?;
    if curve.is_empty() {
        eprintln!("singletrack: there is no Hopf point at these speeds, for any dl");
    }
    match args.format {
        DrawnFormat::Csv => print(&hopf_table(&curve).to_csv())?,
        DrawnFormat::Json => {
            let points: Vec<_> = curve.iter().map(document).collect();
            write_json(&subject, &points)?;
        }
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
    let mut curve = Vec::with_capacity(speeds.values().len());
    for speed in speeds.values() {
        curve.extend(subject.hopf_points(*speed)?);
    }
    Ok(curve)
}

/// The numbers of Hopf points.
#[must_use]
pub fn hopf_table(curve: &[HopfPoint]) -> Table {
    Table::of(
        curve,
        &[
            ("speed_m_s", |point| point.speed),
            ("dl_hopf_m", |point| point.deviation),
            ("omega_rad_s", |point| point.angular_frequency),
            ("l1_kuznetsov", |point| point.lyapunov.kuznetsov),
            ("l1_matcont", |point| point.lyapunov.matcont),
        ],
    )
}

fn document(point: &HopfPoint) -> serde_json::Value {
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
}
