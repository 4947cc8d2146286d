//! Regions of attraction of the straight motion with proofs, beside the basin that simulation finds.

use std::{fs, path::PathBuf, time::Instant};

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::Attraction;
use singletrack_campaign::{run_shown, thread_count};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, SaturationArgs},
    figures,
    subject::{Grid, Subject, write_json},
};
use crate::{Result, table::Table};

#[derive(Clone, Debug, Args)]
#[command(
    mut_arg("tyres", |arg| arg.default_value("saturating")),
    mut_arg("slip_angles", |arg| arg.default_value("exact")),
    mut_arg("max_steering", |arg| arg.default_value("0.45").hide_default_value(false)
        .help("Steering stop, in rad")),
    mut_arg("max_steering_rate", |arg| arg.default_value("5").hide_default_value(false)
        .help("Largest steering rate, in rad/s")),
)]
pub(super) struct AttractionArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speeds of the straight motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.5:2:0.5")]
    speeds: Grid,
    /// Deviation dl of the centre of mass, in m
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    dl: f64,
    /// The largest yaw error that is to be proved, in rad; a small one takes less time
    #[arg(long, value_name = "RAD", default_value_t = f64::INFINITY, hide_default_value = true)]
    most_yaw: f64,
    #[command(flatten)]
    saturation: SaturationArgs,
    /// Write the quadratic forms that prove it, as JSON
    #[arg(long, value_name = "FILE")]
    certificates: Option<PathBuf>,
    /// How to write it
    #[arg(long, value_enum, default_value_t = DrawnFormat::Csv)]
    format: DrawnFormat,
}

/// The region of attraction and the basin at a speed.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct AttractionRow {
    pub(super) speed_m_s: f64,
    /// The level of the quadratic form; zero if none is proved.
    level: f64,
    /// From all smaller yaw errors the straight motion is proved to be regained.
    pub(super) proved_yaw_rad: f64,
    /// From all smaller yaw errors it is regained in simulation.
    pub(super) simulated_yaw_rad: f64,
    /// The boxes of the proof, and the time to find and prove it.
    boxes: u32,
    time_s: f64,
}

pub(super) fn run(args: &AttractionArgs) -> Result {
    let subject = args.subject.subject()?;
    let of_speed = |speed_m_s: f64| -> Result<_> {
        let begin = Instant::now();
        let at = subject.at(speed_m_s, args.dl)?;
        let at = at.saturating(args.saturation.saturation())?;
        let region = at.attraction(args.most_yaw)?;
        let row = AttractionRow {
            speed_m_s,
            level: region.map_or(0.0, |region| region.level),
            proved_yaw_rad: region.map_or(0.0, |region| region.yaw()),
            simulated_yaw_rad: at.basin(None)?.yaw,
            boxes: region.map_or(0, |region| region.boxes),
            time_s: begin.elapsed().as_secs_f64(),
        };
        Ok((row, region))
    };
    let speeds = args.speeds.values();
    let units: Vec<u64> = (0..speeds.len() as u64).collect();
    let work = |unit: u64| of_speed(speeds[unit as usize]);
    let found = run_shown("attraction", &units, thread_count(), work)?;
    let found: Vec<_> = found.into_iter().map(|(_, found)| found).collect();
    if let Some(path) = &args.certificates {
        let proofs: Vec<Value> = found
            .iter()
            .filter_map(|(row, region)| Some(certificate(args, &subject, row, region.as_ref()?)))
            .collect();
        let text = format!("{:#}\n", json!({ "certificates": proofs }));
        fs::write(path, text)?;
    }
    let rows: Vec<AttractionRow> = found.iter().map(|(row, _)| *row).collect();
    match args.format {
        DrawnFormat::Csv => {
            let header = "speed_m_s,level,proved_yaw_rad,simulated_yaw_rad,boxes,time_s";
            print(&Table::of(header, &rows).to_csv())?;
        }
        DrawnFormat::Json => write_json(&subject, &rows)?,
        DrawnFormat::Svg => print(&figures::attraction(&rows).to_svg())?,
    }
    Ok(())
}

/// All that a program needs which derives the loop for itself, and checks that x'Px falls.
fn certificate(
    args: &AttractionArgs,
    subject: &Subject,
    row: &AttractionRow,
    region: &Attraction,
) -> Value {
    let saturation = args.saturation.saturation();
    let limit = |limit: f64| limit.is_finite().then_some(limit);
    let rows: Vec<Vec<f64>> = (region.form.row_iter())
        .map(|row| row.iter().copied().collect())
        .collect();
    json!({
        "law": subject.law.name(),
        "vehicle": subject.vehicle,
        "point_distance_m": subject.point_distance,
        "speed_m_s": row.speed_m_s,
        "dl_m": args.dl,
        "tyres": saturation.tyres.name(),
        "slip_angles": saturation.slip_angles,
        "max_steering_rad": limit(saturation.max_steering),
        "max_steering_rate_rad_s": limit(saturation.max_steering_rate),
        "coordinates": ["yaw_rad", "yaw_rate_rad_s", "sideslip_rad", "steering_rad"],
        "form": rows,
        "level": region.level,
        "yaw_rad": region.yaw(),
    })
}
