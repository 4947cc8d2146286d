//! `singletrack stability`: the paper's bifurcation studies, for any car, and the
//! sampled loop that it leaves out.

mod eigenvalues;
pub mod figures;
mod grid;
mod hopf;
mod jacobian;
mod output;
mod region;
mod sampled;
mod summary;

use std::{io, path::PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use singletrack_analysis::stability::{Belief, ClosedLoop, Law, SamplingError, StabilityError};
use singletrack_control::VehicleParameters;

pub use eigenvalues::{EigenvalueRow, eigenvalue_map};
pub use grid::Grid;
pub use hopf::hopf_curve;
pub use region::{RegionRow, region};
pub use sampled::{SampledRow, TimingArgs, sampled_map};

use crate::{
    figure::GridError,
    vehicle_file::{self, VehicleFileError},
};

/// What is to be known of the steady motion.
#[derive(Clone, Debug, Args)]
pub struct StabilityArgs {
    #[command(subcommand)]
    command: StabilityCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum StabilityCommand {
    /// In words: where each law is stable, with the car's own numbers.
    Summary(summary::SummaryArgs),
    /// The linearisation at one steady motion.
    Jacobian(jacobian::JacobianArgs),
    /// Hopf bifurcations over dl: frequency and first Lyapunov coefficient.
    Hopf(hopf::HopfArgs),
    /// Eigenvalues of the steady motion over speed and dl.
    Eigenvalues(eigenvalues::EigenvaluesArgs),
    /// Where the steady motion is stable, over speed and dl.
    Region(region::RegionArgs),
    /// The sampled loop: spectral radius, delay margin, longest marker interval.
    Sampled(sampled::SampledArgs),
    /// The paper's figures of all this, as SVG files.
    Figures(figures::FiguresArgs),
}

/// The car and its law.
#[derive(Clone, Debug, Args)]
struct LoopArgs {
    /// The linearising law
    #[arg(long, value_enum)]
    law: LawName,
    /// Which distances the law has wrong by dl
    #[arg(long, value_enum, default_value_t = BeliefName::CentreOfMass)]
    wrong: BeliefName,
    #[command(flatten)]
    car: CarArgs,
}

/// The car and its P.
#[derive(Clone, Debug, Args)]
struct CarArgs {
    /// A TOML file with a table [vehicle] [default: the paper's car]
    #[arg(long, value_name = "FILE")]
    vehicle: Option<PathBuf>,
    /// Distance p of the point P, in m
    #[arg(
        long,
        value_name = "M",
        allow_negative_numbers = true,
        default_value_t = 0.35
    )]
    point_distance: f64,
}

/// The laws by name, as in a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LawName {
    /// The proposed law: P before the front axle
    FrontPoint,
    /// The law of the appendix: P before the centre of mass
    VelocityPoint,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BeliefName {
    /// The centre of mass: `l_f` + dl and `l_r` - dl, as in the paper
    CentreOfMass,
    /// The front axle alone: `l_f` + dl
    FrontAxle,
}

/// How a result is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A header and a row for each point
    Csv,
    /// One document, with the car and all that is known of each point
    Json,
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum StabilityCommandError {
    /// There is no such car.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// There is no steady motion.
    #[error(transparent)]
    Stability(#[from] StabilityError),
    /// The loop can't be sampled so.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// There is nothing to draw a map of.
    #[error("can't draw this: {0}")]
    Grid(#[from] GridError),
    /// The result can't be written.
    #[error("can't write the result: {0}")]
    Write(#[from] io::Error),
}

/// A car, its P and its law, as told on the command line.
#[derive(Clone, Copy, Debug)]
pub struct Subject {
    /// The car.
    pub vehicle: VehicleParameters,
    /// The law.
    pub law: Law,
    /// What it has wrong.
    pub belief: Belief,
    /// The distance p, in m.
    pub point_distance: f64,
}

impl Subject {
    /// Its steady motion at a speed (m/s), with the centre of mass believed `deviation`
    /// (m) behind where it is.
    ///
    /// # Errors
    ///
    /// A parameter with which there is no steady motion.
    pub fn at(&self, speed: f64, deviation: f64) -> Result<ClosedLoop, StabilityError> {
        Ok(ClosedLoop::new(
            self.vehicle,
            self.law,
            self.point_distance,
            speed,
            deviation,
        )?
        .believing(self.belief))
    }

    /// The deviations that the paper looks at: all meaningful ones, and for the
    /// front-point law as far down as its bifurcations lie.
    #[must_use]
    pub fn usual_deviations(&self) -> Grid {
        let [from, to] = ClosedLoop::meaningful_deviations(&self.vehicle);
        let from = match self.law {
            Law::FrontPoint => {
                -(self.vehicle.wheelbase_m() + self.point_distance) - 0.3 * from.abs()
            }
            Law::VelocityPoint => from,
        };
        Grid::spanning([from, to], 121)
    }
}

impl LoopArgs {
    fn subject(&self) -> Result<Subject, VehicleFileError> {
        Ok(Subject {
            vehicle: vehicle_file::read_or_paper(self.car.vehicle.as_deref())?,
            law: match self.law {
                LawName::FrontPoint => Law::FrontPoint,
                LawName::VelocityPoint => Law::VelocityPoint,
            },
            belief: match self.wrong {
                BeliefName::CentreOfMass => Belief::CentreOfMass,
                BeliefName::FrontAxle => Belief::FrontAxle,
            },
            point_distance: self.car.point_distance,
        })
    }
}

/// Computes what is asked for and writes it to standard output.
///
/// # Errors
///
/// A car, law or range that makes no sense, or a result that can't be written.
pub fn run(args: &StabilityArgs) -> Result<(), StabilityCommandError> {
    let result = match &args.command {
        StabilityCommand::Summary(args) => summary::run(args),
        StabilityCommand::Jacobian(args) => jacobian::run(args),
        StabilityCommand::Hopf(args) => hopf::run(args),
        StabilityCommand::Eigenvalues(args) => eigenvalues::run(args),
        StabilityCommand::Region(args) => region::run(args),
        StabilityCommand::Sampled(args) => sampled::run(args),
        StabilityCommand::Figures(args) => figures::run(args),
    };
    match result {
        // Whoever read it has seen enough.
        Err(StabilityCommandError::Write(error)) if error.kind() == io::ErrorKind::BrokenPipe => {
            Ok(())
        }
        result => result,
    }
}
