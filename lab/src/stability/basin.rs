//! The basin of the straight motion as simulation finds it, and regions of attraction with proofs.

use std::{fs, path::PathBuf, time::Instant};

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{Attraction, Servo};
use singletrack_campaign::{run_shown, thread_count};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, SaturationArgs},
    figures,
    subject::{Format, Grid, Subject, write, write_json},
};
use crate::{Result, Table};

#[derive(Clone, Debug, Args)]
pub(super) struct BasinArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Speeds of the straight motion, in m/s
    #[arg(long, value_name = "A:B:STEP", default_value = "0.5:4:0.5")]
    speeds: Grid,
    /// Distances p of the point P, in m [default: that of --point-distance]
    #[arg(long, value_name = "A:B:STEP")]
    distances: Option<Grid>,
    /// Deviation dl of the centre of mass, in m
    #[arg(long, value_name = "M", default_value_t = 0.0)]
    dl: f64,
    #[command(flatten)]
    saturation: SaturationArgs,
    /// Lag of the steering servo, in ms; 0 for wheels that follow at once
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    steering_lag_ms: f64,
    /// Dead time from the law to the wheels, in ms
    #[arg(long, value_name = "MS", default_value_t = 0.0)]
    steering_dead_time_ms: f64,
    /// How to write it
    #[arg(long, value_enum, default_value_t = DrawnFormat::Csv)]
    format: DrawnFormat,
}

/// The basin at a speed and a p.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct BasinRow {
    pub(super) speed_m_s: f64,
    pub(super) point_distance_m: f64,
    /// The straight motion is regained from smaller yaw errors.
    pub(super) yaw_rad: f64,
    /// Half the peak-to-peak steering in which the car ends just beyond; none if it turns round.
    beyond_amplitude_rad: Option<f64>,
}

pub(super) fn run(args: &BasinArgs) -> Result {
    let subject = args.subject.subject()?;
    let own = Grid::spanning([subject.point_distance; 2], 1);
    let servo = Servo {
        lag: args.steering_lag_ms * 1e-3,
        dead_time: args.steering_dead_time_ms * 1e-3,
    };
    let servo = (servo.lag != 0.0 || servo.dead_time != 0.0).then_some(servo);
    let saturation = args.saturation.saturation();
    let dl = args.dl;
    let at = move |speed: f64, point_distance: f64| {
        let subject = Subject {
            point_distance,
            ..subject
        };
        subject.at(speed, dl)?.saturating(saturation)
    };
    let mut rows = Vec::new();
    let distances = args.distances.as_ref().unwrap_or(&own);
    for (speed_m_s, point_distance_m) in args.speeds.with(distances) {
        let basin = at(speed_m_s, point_distance_m)?.basin(servo)?;
        rows.push(BasinRow {
            speed_m_s,
            point_distance_m,
            yaw_rad: basin.yaw,
            beyond_amplitude_rad: basin.beyond,
        });
    }
    match args.format {
        DrawnFormat::Csv => {
            let header = "speed_m_s,point_distance_m,yaw_rad,beyond_amplitude_rad";
            print(&Table::of(header, &rows).to_csv())?;
        }
        DrawnFormat::Json => write_json(&subject, &rows)?,
        DrawnFormat::Svg => {
            let regains = move |[speed, distance]: [f64; 2], degrees: f64| {
                at(speed, distance).is_ok_and(|at| at.regains(servo, degrees.to_radians()))
            };
            print(&figures::basin(&rows, regains)?.to_svg())?;
        }
    }
    Ok(())
}

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

pub(super) fn run_attraction(args: &AttractionArgs) -> Result {
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
