//! The one length that decides whether a car is stable under the proposed law.

use clap::Args;
use singletrack_analysis::stability::{Belief, ClosedLoop, Law, OneLength};

use super::{
    arguments::CarArgs,
    subject::{Format, Grid, Subject, write},
};
use crate::{Result, table::Table, vehicle_file};

/// Options of `one-length`.
#[derive(Clone, Debug, Args)]
pub(super) struct OneLengthArgs {
    #[command(flatten)]
    car: CarArgs,
    /// Speeds up to which the car is to be stable, in m/s; inf for every speed
    #[arg(long, value_name = "A:B:STEP", default_value = "1,2,3,5,inf", value_parser = speeds)]
    speeds: Speeds,
    /// How to write it
    #[arg(long, value_enum, default_value_t = Format::Csv)]
    format: Format,
}

#[derive(Clone, Debug)]
struct Speeds(Vec<f64>);

fn speeds(text: &str) -> Result<Speeds, String> {
    let (text, is_endless) = match text.strip_suffix("inf") {
        Some(rest) => (rest.trim_end_matches(','), true),
        None => (text, false),
    };
    let mut speeds = match text {
        "" if is_endless => Vec::new(),
        text => text.parse::<Grid>()?.values().to_vec(),
    };
    speeds.extend(is_endless.then_some(f64::INFINITY));
    Ok(Speeds(speeds))
}

pub(super) fn run(args: &OneLengthArgs) -> Result {
    let subject = Subject {
        vehicle: vehicle_file::read_or_paper(args.car.vehicle.as_deref())?,
        law: Law::FrontPoint,
        belief: Belief::CentreOfMass,
        point_distance: args.car.point_distance,
    };
    let range = ClosedLoop::meaningful_deviations(&subject.vehicle);
    let or_none = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let mut rows = Vec::new();
    for speed in &args.speeds.0 {
        let length = OneLength::of(subject.vehicle, *speed)?;
        let endless = length.distances.iter().find(|[_, to]| to.is_infinite());
        let other = length.distances.iter().find(|[_, to]| to.is_finite());
        let mut bounds = Vec::new();
        if speed.is_finite() {
            for dl in Grid::spanning(range, 41).values() {
                bounds.push(subject.at(*speed, *dl)?.actuation_bound());
            }
        }
        let bounds: Option<Vec<f64>> = bounds.into_iter().collect();
        let least = bounds.and_then(|bounds| bounds.into_iter().min_by(f64::total_cmp));
        rows.push(vec![
            *speed,
            or_none(endless.map(|[from, _]| *from)),
            or_none(other.map(|[from, _]| *from)),
            or_none(other.map(|[_, to]| *to)),
            or_none(least),
        ]);
    }
    let header = "speed_m_s,p_from_m,other_from_m,other_to_m,actuation_s".to_owned();
    let table = Table { header, rows };
    Ok(write(args.format, &subject, &table, &table.to_json())?)
}
