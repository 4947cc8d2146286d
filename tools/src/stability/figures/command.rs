//! `singletrack stability figures`: all figures of a car under a law, as files.

use std::{
    fs, io,
    io::Write as _,
    path::{Path, PathBuf},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::{
    Scene, delay_margin, drawn_deviations, eigenvalue, eigenvalues, longest_marker_interval,
    region, scene::around_meaningful, spectral_radius,
};
use crate::{
    figure::Figure,
    stability::{
        Grid, LoopArgs, StabilityCommandError, Subject, TimingArgs, eigenvalue_map, hopf_curve,
        region as stable_region, sampled_map,
    },
};

#[derive(Clone, Debug, Args)]
pub(in crate::stability) struct FiguresArgs {
    #[command(flatten)]
    subject: LoopArgs,
    /// Folder for the SVG files; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Speeds of the steady motion, in m/s
    #[arg(
        long,
        value_name = "A:B:STEP",
        allow_hyphen_values = true,
        default_value = "0.1:8:0.05"
    )]
    speeds: Grid,
    /// Deviations dl of the centre of mass, in m [default: those of the paper's figures]
    #[arg(long, value_name = "A:B:STEP", allow_hyphen_values = true)]
    dl: Option<Grid>,
    #[command(flatten)]
    timing: TimingArgs,
}

/// Deviations in a map of eigenvalues: kinks where pairs meet look sharp.
const DEVIATIONS: usize = 241;
/// Speeds and deviations in a map of the sampled loop, whose every point takes long.
const SAMPLED: [usize; 2] = [120, 91];

/// Draws the figures and names the files.
pub(in crate::stability) fn run(args: &FiguresArgs) -> Result<(), StabilityCommandError> {
    let subject = args.subject.subject()?;
    fs::create_dir_all(&args.out).map_err(|error| cannot_write(&args.out, &error))?;
    let mut out = io::stdout().lock();
    for (name, figure) in figures(&subject, &args.speeds, args.dl.as_ref(), args.timing)? {
        let path = args.out.join(format!("{name}.svg"));
        fs::write(&path, figure.to_svg()).map_err(|error| cannot_write(&path, &error))?;
        writeln!(out, "{}", path.display())?;
    }
    Ok(())
}

fn cannot_write(path: &Path, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// The figures with their names.
fn figures(
    subject: &Subject,
    speeds: &Grid,
    deviations: Option<&Grid>,
    timing: TimingArgs,
) -> Result<Vec<(String, Figure)>, StabilityCommandError> {
    let usual = drawn_deviations(subject, DEVIATIONS);
    let deviations = deviations.unwrap_or(&usual);
    let hopf = hopf_curve(subject, speeds)?;
    let scene = Scene::new(subject, &hopf)?;
    let mut figures = vec![(
        "region".to_owned(),
        region(&scene, &stable_region(subject, speeds, deviations)?)?,
    )];
    let map = eigenvalue_map(subject, speeds, deviations)?;
    figures.push(("eigenvalues".to_owned(), eigenvalues(&scene, &map)?));
    let count = map.first().map_or(0, |row| row.eigenvalues.len());
    for number in 1..=count {
        let figure = eigenvalue(&scene, number, &map)?;
        figures.push((format!("eigenvalue-{number}"), figure));
    }
    let [speed_count, deviation_count] = SAMPLED;
    let ends = match speeds.values() {
        [first, .., last] => [*first, *last],
        [single] => [*single; 2],
        [] => [0.0; 2],
    };
    let speeds = Grid::spanning(ends, speed_count);
    let deviations = Grid::spanning(around_meaningful(subject), deviation_count);
    let bar = ProgressBar::new((speed_count * deviation_count) as u64).with_style(
        ProgressStyle::with_template("{wide_bar} {pos}/{len} points of the sampled loop")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let rows = sampled_map(subject, &speeds, &deviations, timing, || bar.inc(1))?;
    bar.finish_and_clear();
    figures.extend([
        (
            "spectral-radius".to_owned(),
            spectral_radius(&scene, timing, &rows)?,
        ),
        (
            "delay-margin".to_owned(),
            delay_margin(&scene, timing, &rows)?,
        ),
        (
            "marker-interval".to_owned(),
            longest_marker_interval(&scene, timing, &rows)?,
        ),
    ]);
    Ok(figures)
}
