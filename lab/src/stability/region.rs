//! Where the steady motion is stable, and the basin of the straight motion.

use clap::Args;
use serde::Serialize;
use singletrack_analysis::stability::{Servo, StabilityError};
use singletrack_figures::output::print;

use super::{
    arguments::{DrawnFormat, LoopArgs, MapArgs, SaturationArgs},
    figures,
    subject::{Grid, Subject, write, write_json},
};
use crate::{Result, table::Table};

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
