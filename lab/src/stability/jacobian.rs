//! The linearisation at one steady motion.

use std::io;

use clap::Args;
use nalgebra::DMatrix;
use serde_json::json;
use singletrack_analysis::stability::Law;
use singletrack_figures::output::print;

use super::{
    arguments::{Format, LoopArgs},
    output::write_json,
    subject::StabilityCommandError,
};

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

pub(super) fn run(args: &JacobianArgs) -> Result<(), StabilityCommandError> {
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
