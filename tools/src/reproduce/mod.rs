//! `singletrack reproduce`: the paper's experiments and analyses, and its claims beside
//! what they come to here.

mod catalogue;
mod circle;
pub mod claims;
mod comparison;
mod drive;
mod folder;
mod pictures;
mod progress;
mod report;
mod sampled;
mod section;
mod setup;
mod stability;
mod steps;
mod table;
mod text;

use std::{
    io,
    path::{Path, PathBuf},
};

use clap::Args;

pub use section::{Picture, Plate, Section, Table};
pub use setup::Setup;

use crate::vehicle_file::{self, VehicleFileError};
use claims::{Judged, Measurements, judge, surprises};
use progress::Progress;

/// What `singletrack reproduce` is asked.
#[derive(Args, Clone, Debug)]
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

/// Why the paper was not reproduced.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// There is no such car.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// Something can't be written.
    #[error("can't write {}: {source}; choose another folder with --out", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The folder is somebody else's.
    #[error(
        "{} holds other things than an earlier reproduction ({found}); choose another folder \
         with --out",
        path.display()
    )]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// The first thing in it.
        found: String,
    },
    /// A claim came out otherwise than it should.
    #[error(
        "{count} of the claims came out otherwise than expected: see the lines marked with ! and {}",
        report.display()
    )]
    Surprise {
        /// How many.
        count: usize,
        /// The report.
        report: PathBuf,
    },
}

/// Everything that was computed.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The car.
    pub setup: Setup,
    /// The sections of the report, in order.
    pub sections: Vec<Section>,
    /// The claims with their verdicts.
    pub claims: Vec<Judged>,
}

/// Reproduces the paper: the table of claims on standard output, all else in a folder.
///
/// # Errors
///
/// When it can't be written, or when a claim came out otherwise than it should; what
/// was computed is written all the same.
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
    let reproduction = reproduce(setup);
    let report = folder::write(&args.out, &reproduction)?;
    table::print(&reproduction, &report);
    match surprises(&reproduction.claims) {
        0 => Ok(()),
        count => Err(ReproduceError::Surprise { count, report }),
    }
}

/// Computes everything; shows progress on a terminal.
#[must_use]
pub fn reproduce(setup: Setup) -> Reproduction {
    let parts: [fn(&Setup, &Progress) -> Section; 7] = [
        steps::section,
        circle::section,
        stability::proposed,
        stability::eigenvalues,
        stability::appendix,
        comparison::section,
        sampled::section,
    ];
    let progress = Progress::new(parts.len());
    let mut sections = Vec::new();
    let mut measurements = basics(&setup);
    for part in parts {
        let section = part(&setup, &progress);
        measurements.extend(section.measurements.clone());
        sections.push(section);
        progress.done();
    }
    progress.finish();
    let claims = judge(catalogue::claims(&setup), &measurements, setup.is_paper());
    Reproduction {
        setup,
        sections,
        claims,
    }
}

/// What needs no experiment: the car's own numbers, and where the law has no answer.
fn basics(setup: &Setup) -> Measurements {
    let mut measurements = Measurements::default();
    measurements.add("vehicle.l_r", setup.vehicle.rear_axle_distance_m);
    // The corners of the ranges that the paper states, in degrees.
    let (sideslip, steering) = (40.0_f64, 50.0_f64);
    measurements.add("law.largest_angle", sideslip + steering);
    measurements
}

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> ReproduceError + use<> {
    let path = path.to_owned();
    move |source| ReproduceError::Write { path, source }
}
