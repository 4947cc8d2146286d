//! The figures of the stability analysis: the paper's, over speed and dl, and those of
//! the loop as it is sampled. They show the results of the other modules, and
//! `singletrack stability figures` writes those of a car under a law as files.

mod maps;
mod scene;

use std::{
    io::{self, Write as _},
    path::PathBuf,
};

use clap::{Args, ValueEnum};
use singletrack_figures::{
    figure::Figure,
    output::{make_folder, write},
};

use super::{
    Grid, SampledRow, Subject,
    arguments::{LoopArgs, PointArgs, TimingArgs},
    eigenvalue_map, hopf_curve,
    limits::shown_map,
    region as stable_region,
};
use crate::Result;

pub(super) use maps::basin;
pub use maps::{cycles, eigenvalues, region, sampled};
pub use scene::{Scene, around_meaningful, drawn_deviations};

#[derive(Clone, Debug, Args)]
#[command(mut_arg("dl", |dl| {
    dl.help(
        "Deviations dl of the centre of mass, in m [default: the meaningful ones with a \
         margin, and as far down as the bifurcations lie]",
    )
}))]
pub(super) struct FiguresArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Folder for the SVG files; created if needed
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Which figures to draw
    #[arg(
        long = "figure",
        value_enum,
        value_delimiter = ',',
        default_values_t = Kind::value_variants().to_vec()
    )]
    figures: Vec<Kind>,
    #[command(flatten)]
    points: PointArgs,
    #[command(flatten)]
    timing: TimingArgs,
}

/// A figure, or some of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Stable and unstable regions, Hopf curve, first Lyapunov coefficients
    Region,
    /// Real parts of all eigenvalues, together and each
    Eigenvalues,
    /// The sampled loop's spectral radius
    SpectralRadius,
    /// The delay that the sampled loop survives
    DelayMargin,
    /// The time between poses that the sampled loop survives
    MarkerInterval,
}

/// Deviations in a map of eigenvalues: kinks where pairs meet look sharp.
const DEVIATIONS: usize = 241;
/// Speeds at most, and deviations, in a map of the sampled loop, whose every point
/// takes long.
const MOST_SAMPLED_SPEEDS: usize = 120;
const SAMPLED_DEVIATIONS: usize = 91;

/// Draws the figures and names the files.
pub(super) fn run(args: &FiguresArgs) -> Result {
    let subject = args.subject.subject()?;
    make_folder(&args.out)?;
    for (name, figure) in figures(&subject, args)? {
        let path = args.out.join(format!("{name}.svg"));
        write(&path, &figure.to_svg())?;
        writeln!(io::stdout(), "{}", path.display())?;
    }
    Ok(())
}

/// The figures that are asked for, with their names.
fn figures(subject: &Subject, args: &FiguresArgs) -> Result<Vec<(&'static str, Figure)>> {
    let speeds = &args.points.speeds;
    let deviations = args
        .points
        .deviations_or(|| drawn_deviations(subject, DEVIATIONS));
    let scene = Scene::new(subject, &hopf_curve(subject, speeds)?)?;
    let wants = |kind| args.figures.contains(&kind);
    let mut figures = Vec::new();
    if wants(Kind::Region) {
        let rows = stable_region(subject, speeds, &deviations)?;
        figures.push(("region", region(&scene, &rows)?));
    }
    if wants(Kind::Eigenvalues) {
        let map = eigenvalue_map(subject, speeds, &deviations)?;
        figures.push(("eigenvalues", eigenvalues(&scene, &map)?));
    }
    if wants(Kind::SpectralRadius) || wants(Kind::DelayMargin) || wants(Kind::MarkerInterval) {
        let rows = sampled_rows(subject, args)?;
        let kinds = [
            Kind::SpectralRadius,
            Kind::DelayMargin,
            Kind::MarkerInterval,
        ];
        let drawn = kinds.into_iter().zip(sampled(&scene, args.timing, &rows)?);
        let drawn = drawn.filter(|(kind, _)| wants(*kind));
        figures.extend(drawn.map(|(_, named)| named));
    }
    Ok(figures)
}

/// The sampled loop over the speeds, or as many as there is time for, and dl.
fn sampled_rows(subject: &Subject, args: &FiguresArgs) -> Result<Vec<SampledRow>> {
    let speeds = match args.points.speeds.values() {
        all @ [first, .., last] if all.len() > MOST_SAMPLED_SPEEDS => {
            Grid::spanning([*first, *last], MOST_SAMPLED_SPEEDS)
        }
        _ => args.points.speeds.clone(),
    };
    let deviations = args
        .points
        .deviations_or(|| around_meaningful(subject, SAMPLED_DEVIATIONS));
    let what = "points of the sampled loop";
    shown_map(subject, &speeds, &deviations, args.timing, what)
}
