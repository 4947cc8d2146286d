//! `singletrack reproduce`: the paper's experiments and analyses, and its claims beside
//! measured results.

mod assumptions;
mod circle;
mod comparison;
mod drive;
mod model;
mod output;
mod pictures;
mod sampled;
mod section;
mod stability;
mod steps;

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use indicatif::ProgressBar;
use singletrack::progress::progress_bar;
use singletrack_control::VehicleParameters;
use singletrack_core::config::{LawKind, LawSection};
use singletrack_scenario::simulate::Scenario;

use crate::{Result, vehicle_file};
use section::{Claim, Section};

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

/// Reproduces the paper: the claims on standard output, all else in a folder.
///
/// # Errors
///
/// When a file can't be written, or when a claim's verdict is not the expected one; the
/// files are then written nevertheless.
pub fn run(args: &ReproduceArgs) -> Result {
    let vehicle = vehicle_file::read_or_paper(args.vehicle.as_deref())?;
    let mut setup = Setup {
        vehicle,
        circle: Scenario::from_toml(CIRCLE, Path::new("circle.toml"))?,
        name: "the paper's car".to_owned(),
        quick: args.quick,
    };
    if let Some(path) = &args.vehicle
        && !setup.is_paper()
    {
        setup.name = format!("the car of {}", path.display());
    }
    output::prepare(&args.out)?;
    let reproduction = reproduce(setup);
    let report = output::write(&args.out, &reproduction)?;
    output::print(&reproduction, &report);
    match surprises(reproduction.claims()) {
        0 => Ok(()),
        count => Err(format!(
            "{count} of the claims have another verdict than expected: see the lines marked with ! \
             and {}",
            report.display()
        )
        .into()),
    }
}

/// The number of unexpected verdicts.
fn surprises<'a>(claims: impl Iterator<Item = &'a Claim>) -> usize {
    claims.filter(|claim| claim.surprise.is_some()).count()
}

/// All results of a reproduction.
#[derive(Clone, Debug)]
struct Reproduction {
    setup: Setup,
    /// The sections of the report, in order.
    sections: Vec<Section>,
}

impl Reproduction {
    /// All claims with their verdicts, in the order of the report.
    fn claims(&self) -> impl Iterator<Item = &Claim> + Clone {
        self.sections.iter().flat_map(|section| &section.claims)
    }
}

/// Computes everything; shows progress on a terminal.
fn reproduce(setup: Setup) -> Reproduction {
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
    let progress = progress_bar(parts.len() as u64, "{bar:24} {pos}/{len}  {wide_msg}");
    progress.enable_steady_tick(Duration::from_millis(200));
    let mut sections = Vec::new();
    for part in parts {
        let mut section = part(&setup, &progress);
        for claim in &mut section.claims {
            claim.judge(setup.is_paper());
        }
        sections.push(section);
        progress.inc(1);
    }
    progress.finish_and_clear();
    Reproduction { setup, sections }
}

/// The paper's circle: continuous control of the ideal plant, and nothing else.
const CIRCLE: &str = include_str!("../../../tools/scenarios/circle.toml");
/// Wheelbase of the paper's car, in m, for which its experiments are sized.
const PAPER_WHEELBASE_M: f64 = 0.26;
/// Angular velocity of the circle's reference, in rad/s.
const TURN_RATE: f64 = 0.5;
/// Gain of the position loop, per second.
const GAIN: f64 = 1.0;

/// The car of the reproduction, and its thoroughness.
#[derive(Clone, Debug)]
struct Setup {
    vehicle: VehicleParameters,
    /// Its circle: continuous control of the ideal plant, and nothing else.
    circle: Scenario,
    /// The name of the car.
    name: String,
    /// Coarser maps, shorter drives and fewer seeds.
    quick: bool,
}

impl Setup {
    /// Whether the paper's numbers hold for this car.
    fn is_paper(&self) -> bool {
        self.vehicle == VehicleParameters::paper()
    }

    /// The car's size in units of the paper's: another car drives the paper's
    /// experiments on a floor that is larger by this, in the same time.
    fn scale(&self) -> f64 {
        self.vehicle.wheelbase_m() / PAPER_WHEELBASE_M
    }

    /// Whether the simulated car can represent it: actuators, limits and hall are those
    /// of a car of the paper's kind.
    fn fits_simulated_car(&self) -> bool {
        (0.5..=2.0).contains(&self.scale())
    }

    /// The distance p of P from the front axle: 0.35 m on the paper's car.
    fn point_distance_m(&self) -> f64 {
        0.35 * self.scale()
    }

    /// The radius of the circle: 1 m for the paper's car.
    fn radius_m(&self) -> f64 {
        self.scale()
    }

    /// The radius on which P follows the circle: that of two integrators under proportional
    /// control, a low-pass.
    fn amplitude_m(&self) -> f64 {
        self.radius_m() / (1.0 + (TURN_RATE / GAIN).powi(2)).sqrt()
    }

    /// The circle of this car under a law, with its centre of mass too far to the rear by a
    /// deviation (m).
    fn circle(&self, kind: LawKind, deviation_m: f64) -> Scenario {
        let mut scenario = self.circle.clone();
        scenario.law = LawSection {
            kind,
            point_distance_m: self.point_distance_m(),
            front_axle_distance_m: self.vehicle.front_axle_distance_m + deviation_m,
        };
        scenario.vehicle = self.vehicle;
        scenario
    }

    /// The deviation dl of the paper's second open-loop test: the law's centre of mass is
    /// at the rear axle.
    const fn rear_deviation_m(&self) -> f64 {
        self.vehicle.rear_axle_distance_m
    }
}

/// The largest, or not a number.
fn largest(values: impl Iterator<Item = f64>) -> f64 {
    let either = |one: f64, other| match one >= other || one.is_nan() {
        true => one,
        false => other,
    };
    values.reduce(either).unwrap_or(f64::NAN)
}

/// The least, or not a number.
fn least(values: impl Iterator<Item = f64>) -> f64 {
    -largest(values.map(|value| -value))
}

#[cfg(test)]
impl Setup {
    fn paper() -> Self {
        Self {
            vehicle: VehicleParameters::paper(),
            circle: toml::from_str(CIRCLE).unwrap(),
            name: "the paper's car".to_owned(),
            quick: true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_car_drives_the_same_experiments_as_much_larger_as_it_is() {
        let paper = Setup::paper();
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

    #[test]
    fn nothing_and_what_is_not_a_number_have_no_extremes() {
        assert_eq!(largest([1.0, -3.0, 2.0].into_iter()), 2.0);
        assert_eq!(least([1.0, -3.0, 2.0].into_iter()), -3.0);
        for values in [
            &[][..],
            &[f64::NAN, 1.0],
            &[1.0, f64::NAN],
            &[1.0, f64::NAN, 2.0],
        ] {
            assert!(largest(values.iter().copied()).is_nan(), "{values:?}");
            assert!(least(values.iter().copied()).is_nan(), "{values:?}");
        }
    }
}
