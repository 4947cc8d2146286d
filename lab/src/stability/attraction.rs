//! Regions of attraction of the straight motion with proofs, beside the basin that simulation finds.

use std::{fs, path::PathBuf, time::Instant};

use clap::Args;
use serde_json::{Value, json};
use singletrack_analysis::stability::Attraction;
use singletrack_campaign::{run_shown, thread_count};

use super::{
    arguments::{LoopArgs, SaturationArgs},
    subject::{Format, Grid, Subject, write},
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
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

pub(super) fn run(args: &AttractionArgs) -> Result {
    let subject = args.subject.subject()?;
    // A row, and the certificate of a region that is proved. Without one the level is zero.
    let of_speed = |speed: f64| -> Result<(Value, Option<Value>)> {
        let begin = Instant::now();
        let at = subject.at(speed, args.dl)?;
        let at = at.saturating(args.saturation.saturation())?;
        let region = at.attraction(args.most_yaw)?;
        let row = json!({
            "speed_m_s": speed,
            "level": region.map_or(0.0, |region| region.level),
            "proved_yaw_rad": region.map_or(0.0, |region| region.yaw()),
            "simulated_yaw_rad": at.basin(None)?.yaw,
            "boxes": region.map_or(0, |region| region.boxes),
            "time_s": begin.elapsed().as_secs_f64(),
        });
        let proof = region.map(|region| certificate(args, &subject, speed, &region));
        Ok((row, proof))
    };
    let speeds = args.speeds.values();
    let units: Vec<u64> = (0..speeds.len() as u64).collect();
    let work = |unit: u64| of_speed(speeds[unit as usize]);
    let found = run_shown("attraction", &units, thread_count(), work)?;
    let (rows, proofs): (Vec<Value>, Vec<Option<Value>>) =
        found.into_iter().map(|(_, found)| found).unzip();
    if let Some(path) = &args.certificates {
        let proofs: Vec<Value> = proofs.into_iter().flatten().collect();
        let text = format!("{:#}\n", json!({ "certificates": proofs }));
        fs::write(path, text)?;
    }
    let header = "speed_m_s,level,proved_yaw_rad,simulated_yaw_rad,boxes,time_s";
    let table = Table::of(header, &rows);
    Ok(write(args.format, &subject, &table, &rows)?)
}

/// All that a program needs which derives the loop for itself, and checks that x'Px falls.
fn certificate(args: &AttractionArgs, subject: &Subject, speed: f64, region: &Attraction) -> Value {
    let saturation = args.saturation.saturation();
    let limit = |limit: f64| limit.is_finite().then_some(limit);
    let rows: Vec<Vec<f64>> = (region.form.row_iter())
        .map(|row| row.iter().copied().collect())
        .collect();
    json!({
        "law": subject.law.name(),
        "vehicle": subject.vehicle,
        "point_distance_m": subject.point_distance,
        "speed_m_s": speed,
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
