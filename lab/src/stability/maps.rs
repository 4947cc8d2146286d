//! The steady motion over speed and dl: where it is stable, and its eigenvalues; the Hopf curve, where
//! stability ends, speed by speed, and the limit cycles born there; the basin of the straight motion as
//! simulation finds it, and regions of attraction with proofs.

use std::{fs, path::PathBuf, time::Instant};

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{
    Attraction, CycleBranch, Eigenvalues, HopfPoint, LimitCycle, Saturation, Servo, StabilityError,
};
use singletrack_campaign::{run_shown, thread_count};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, MapArgs, SaturationArgs},
    figures::{self, Scene},
    subject::{Format, Grid, Subject, write, write_json},
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

pub(super) fn run_basin(args: &BasinArgs) -> Result {
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
