//! Eigenvalue maps, and the linearisation at one steady motion.

use std::io;

use clap::Args;
use nalgebra::DMatrix;
use serde_json::json;
use singletrack_analysis::stability::{Eigenvalues, Law, StabilityError};
use singletrack_figures::output::print;

use super::{
    arguments::{LoopArgs, MapArgs},
    subject::{Format, Grid, Subject, write, write_json},
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
    /// By ascending real part, in 1/s.
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

#[derive(Clone, Debug, Args)]
pub(super) struct JacobianArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speed of the steady motion, in m/s
    #[arg(long, value_name = "M_S")]
    speed: f64,
    /// Deviation dl of the centre of mass, in m
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    dl: f64,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

/// The states, each with the unit of its column, in rad and s.
const STATES: [&str; 4] = ["yaw", "yaw_rate", "sideslip", "steering"];

pub(super) fn run_jacobian(args: &JacobianArgs) -> Result {
    let subject = args.subject.subject()?;
    let closed_loop = subject.at(args.speed, args.dl)?;
    let jacobian = closed_loop.jacobian();
    let states = match subject.law {
        Law::FrontPoint => &STATES[..],
        Law::VelocityPoint => &STATES[..3],
    };
    match args.format {
        Format::Csv => write_csv(states, &jacobian)?,
        Format::Json => {
            let rows: Vec<Vec<f64>> = jacobian
                .row_iter()
                .map(|row| row.iter().copied().collect())
                .collect();
            let polynomial = closed_loop
                .characteristic_polynomial()
                .coefficients()
                .to_vec();
            let eigenvalues: Vec<_> = closed_loop
                .eigenvalues()
                .iter()
                .map(|value| [value.re, value.im])
                .collect();
            let point = json!({
                "speed_m_s": args.speed,
                "dl_m": args.dl,
                "states": states,
                "jacobian": rows,
                "characteristic_polynomial_ascending": polynomial,
                "eigenvalues_per_s": eigenvalues,
                "stable": closed_loop.is_stable(),
            });
            write_json(&subject, &[point])?;
        }
    }
    Ok(())
}

fn write_csv(states: &[&str], jacobian: &DMatrix<f64>) -> io::Result<()> {
    let mut text = format!("derivative_of,{}\n", states.join(","));
    for (state, row) in states.iter().zip(jacobian.row_iter()) {
        let cells: Vec<String> = row.iter().map(f64::to_string).collect();
        text += &format!("{state},{}\n", cells.join(","));
    }
    print(&text)
}
