//! `singletrack stability`: the paper's bifurcation studies, for any car, and the
//! sampled loop that it leaves out.

mod arguments;
pub mod figures;
mod limits;
mod losses;
mod maps;
mod subject;
mod summary;

use std::io;

use clap::{Args, Subcommand};
use singletrack_figures::figure::GridError;

use crate::Result;

pub use arguments::TimingArgs;
pub use limits::{SampledRow, first_unstable, least_p, sampled_map, sampled_table};
pub use maps::{
    EigenvalueRow, RegionRow, eigenvalue_map, eigenvalue_table, hopf_curve, hopf_table,
    limit_cycles, region,
};
pub use subject::{Grid, Subject};

/// Options of `singletrack stability`.
#[derive(Clone, Debug, Args)]
pub struct StabilityArgs {
    #[command(subcommand)]
    command: StabilityCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum StabilityCommand {
    /// In words: where each law is stable, with the car's own numbers.
    Summary(summary::SummaryArgs),
    /// Hopf bifurcations over dl: frequency and first Lyapunov coefficient.
    Hopf(maps::HopfArgs),
    /// Limit cycles from the Hopf points on: amplitude, period, Floquet multiplier, folds.
    Cycles(maps::CyclesArgs),
    /// The yaw errors from which the straight motion is regained, over speed and p.
    Basin(maps::BasinArgs),
    /// Regions of attraction of the straight motion over speed, with proofs, beside the simulated basin.
    Attraction(maps::AttractionArgs),
    /// Eigenvalues of the steady motion over speed and dl.
    Eigenvalues(arguments::MapArgs),
    /// Where the steady motion is stable, over speed and dl.
    Region(arguments::MapArgs),
    /// The sampled loop: spectral radius, delay margin, longest constant marker interval.
    Sampled(limits::SampledArgs),
    /// Lost poses: which irregular intervals, and which random bursts, the motion survives, with proofs.
    Losses(losses::LossesArgs),
    /// The distances p that make a car stable at every speed, in closed form, and what actuation they bear.
    OneLength(limits::OneLengthArgs),
    /// The first unstable speed, with a servo: over p, dl and delay.
    FirstUnstableSpeed(limits::FirstUnstableArgs),
    /// The least p that is stable, with a servo: over speed and delay.
    LeastP(limits::LeastArgs),
    /// The paper's figures of all this, as SVG files.
    Figures(figures::FiguresArgs),
}

/// Runs the subcommand and writes its result to standard output.
///
/// # Errors
///
/// An invalid car, law or range, or a result that can't be written.
pub fn run(args: &StabilityArgs) -> Result {
    let result = match &args.command {
        StabilityCommand::Summary(args) => summary::run(args),
        StabilityCommand::Hopf(args) => maps::run_hopf(args),
        StabilityCommand::Cycles(args) => maps::run_cycles(args),
        StabilityCommand::Basin(args) => maps::run_basin(args),
        StabilityCommand::Attraction(args) => maps::run_attraction(args),
        StabilityCommand::Eigenvalues(args) => maps::run_eigenvalues(args),
        StabilityCommand::Region(args) => maps::run(args),
        StabilityCommand::Sampled(args) => limits::run(args),
        StabilityCommand::Losses(args) => losses::run(args),
        StabilityCommand::OneLength(args) => limits::run_one_length(args),
        StabilityCommand::FirstUnstableSpeed(args) => limits::run_first_unstable(args),
        StabilityCommand::LeastP(args) => limits::run_least(args),
        StabilityCommand::Figures(args) => figures::run(args),
    };
    result.or_else(|error| match error.downcast_ref::<io::Error>() {
        // The reader of a pipe may close it at any time.
        Some(cause) if cause.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Some(cause) => Err(format!("can't write the result: {cause}").into()),
        None if error.is::<GridError>() => Err(format!("can't draw this: {error}").into()),
        None => Err(error),
    })
}
