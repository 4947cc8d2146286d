//! `singletrack reproduce`: the paper's experiments and analyses, and its claims beside
//! measured results.

mod assumptions;
mod catalogue;
mod circle;
pub mod claims;
mod comparison;
mod drive;
mod folder;
mod model;
mod pictures;
mod report;
mod sampled;
mod section;
mod setup;
mod stability;
mod steps;
mod table;
mod text;

use std::{path::PathBuf, time::Duration};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use singletrack_control::{Motion, Singularity, direction};

pub use section::{Picture, Plate, Reproduction, Section};
pub use setup::ReproduceError;
pub use setup::Setup;

use crate::vehicle_file;
use claims::{Claim, Measurements, judge, surprises};

/// Options of `singletrack reproduce`.
#[derive(Clone, Debug, Args)]
pub struct ReproduceArgs {
    /// Where the report, its figures, its data and the claims go
    #[arg(long, value_name = "DIR", default_value = "singletrack-reproduction")]
    pub out: PathBuf,

    /// The car: a TOML file with a table `vehicle` [default: the paper's]
    #[arg(long, value_name = "FILE")]
    pub vehicle: Option<PathBuf>,

    /// Coarser maps, shorter drives and fewer seeds
    #[arg(long)]
    pub quick: bool,
}

/// Reproduces the paper: the table of claims on standard output, all else in a folder.
///
/// # Errors
///
/// When a file can't be written, or when a claim's verdict is not the expected one; the
/// files are then written nevertheless.
pub fn run(args: &ReproduceArgs) -> Result<(), ReproduceError> {
    let vehicle = vehicle_file::read_or_paper(args.vehicle.as_deref())?;
    let mut setup = Setup {
        vehicle,
        name: "the paper's car".to_owned(),
        quick: args.quick,
    };
    if let Some(path) = &args.vehicle
        && !setup.is_paper()
    {
        setup.name = format!("the car of {}", path.display());
    }
    folder::prepare(&args.out)?;
    let reproduction = reproduce(setup)?;
    let report = folder::write(&args.out, &reproduction)?;
    table::print(&reproduction, &report);
    outcome(&reproduction.claims, report)
}

/// Fails if a claim's verdict is not the expected one.
fn outcome(claims: &[Claim], report: PathBuf) -> Result<(), ReproduceError> {
    match surprises(claims) {
        0 => Ok(()),
        count => Err(ReproduceError::Surprise { count, report }),
    }
}

/// Computes everything; shows progress on a terminal.
///
/// # Errors
///
/// The catalogue of the claims can't be read.
pub fn reproduce(setup: Setup) -> Result<Reproduction, ReproduceError> {
    let claims = catalogue::claims(&setup)?;
    let parts: [fn(&Setup, &ProgressBar) -> Section; 8] = [
        model::section,
        steps::section,
        circle::section,
        stability::proposed,
        stability::eigenvalues,
        stability::appendix,
        comparison::section,
        sampled::section,
    ];
    // Hidden when standard error is no terminal.
    let progress = ProgressBar::new(parts.len() as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:24} {pos}/{len}  {wide_msg}") {
        progress.set_style(style);
    }
    progress.enable_steady_tick(Duration::from_millis(200));
    let mut sections = Vec::new();
    let mut measurements = basics(&setup);
    for part in parts {
        let section = part(&setup, &progress);
        measurements.extend(section.measurements.clone());
        sections.push(section);
        progress.inc(1);
    }
    progress.finish_and_clear();
    let claims = judge(claims, &measurements, setup.is_paper());
    Ok(Reproduction {
        setup,
        sections,
        claims,
    })
}

/// Results without an experiment: the car's parameters, and the singularity of the law.
fn basics(setup: &Setup) -> Measurements {
    let mut measurements = Measurements::default();
    measurements.add("vehicle.l_r", setup.vehicle.rear_axle_distance_m);
    // A corner of the ranges that the paper states.
    if let Some(cosine) = cosine_refused(setup, 40.0, -50.0) {
        measurements.add("law.cosine_at_corner", cosine);
    }
    assumptions::measure(setup, &mut measurements);
    measurements
}

/// cos(β - δ) at which the law has no solution, if that is so at these angles, in
/// degrees.
fn cosine_refused(setup: &Setup, sideslip: f64, steering: f64) -> Option<f64> {
    let motion = Motion {
        yaw: 0.0,
        yaw_rate: 0.0,
        sideslip: sideslip.to_radians(),
    };
    let law = assumptions::law(setup, 0.0, setup.point_distance_m())?;
    match law.command(&motion, steering.to_radians(), &direction(0.0)) {
        Err(Singularity::WheelsAcrossVelocity { cosine }) => Some(cosine),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::VehicleParameters;

    use super::*;

    fn setup() -> Setup {
        Setup {
            vehicle: VehicleParameters::paper(),
            name: "the paper's car".to_owned(),
            quick: true,
        }
    }

    #[test]
    fn a_measurement_that_should_agree_and_does_not_fails_the_command() {
        let wrong = |value| {
            let mut measurements = Measurements::default();
            measurements.add("hopf.velocity.threshold_mm", value);
            let claims = catalogue::claims(&setup()).unwrap();
            let claims = claims
                .into_iter()
                .filter(|claim| claim.id == "appendix-threshold");
            let judged = judge(claims.collect(), &measurements, true);
            assert_eq!(judged.len(), 1);
            (
                judged[0].verdict,
                outcome(&judged, PathBuf::from("report.html")).map_err(|error| error.to_string()),
            )
        };
        assert_eq!(wrong(0.135_977).0, claims::Verdict::Agrees);
        assert_eq!(wrong(0.135_977).1, Ok(()));
        let (verdict, outcome) = wrong(0.442);
        assert_eq!(verdict, claims::Verdict::Differs);
        let error = outcome.unwrap_err();
        assert!(
            error.contains("1 of the claims") && error.contains("report.html"),
            "{error}"
        );
    }

    #[test]
    fn the_law_has_no_answer_at_the_corner_of_the_stated_ranges() {
        let cosine = cosine_refused(&setup(), 40.0, -50.0).unwrap();
        assert!(cosine.abs() < 1e-15, "{cosine}");
        assert_eq!(cosine_refused(&setup(), 40.0, -26.0), None);
    }

    #[test]
    fn without_measurements_nothing_agrees_and_every_claim_is_a_surprise() {
        let judged = judge(
            catalogue::claims(&setup()).unwrap(),
            &Measurements::default(),
            true,
        );
        assert_eq!(surprises(&judged), judged.len());
        assert!(
            judged
                .iter()
                .all(|one| one.verdict != claims::Verdict::Agrees)
        );
    }

    #[test]
    fn another_car_drives_the_same_experiments_as_much_larger_as_it_is() {
        let paper = setup();
        let twice = Setup {
            vehicle: VehicleParameters {
                front_axle_distance_m: 0.2736,
                rear_axle_distance_m: 0.2464,
                ..paper.vehicle
            },
            ..paper.clone()
        };
        assert!(paper.is_paper() && !twice.is_paper());
        assert!((paper.scale() - 1.0).abs() < 1e-12 && (twice.scale() - 2.0).abs() < 1e-12);
        assert!((twice.point_distance_m() - 0.7).abs() < 1e-12);
        assert!((twice.radius_m() - 2.0).abs() < 1e-12);
    }
}
