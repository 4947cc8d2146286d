//! An experiment of a campaign: runs it, shows its progress, or reads its results.

use std::{
    io::{self, IsTerminal as _, Write as _},
    path::PathBuf,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use crate::{
    Result,
    file::{Header, ResultFile, merge_files},
    shard::{Experiment, Results, Shard, run_units, thread_count},
};

/// A campaign that was run or read.
#[derive(Debug)]
pub struct Campaign<E: Experiment> {
    /// The experiment: that of the files if they were read.
    pub experiment: E,
    /// Which part of it this is.
    pub shard: Shard,
    /// The results.
    pub results: Results<E>,
}

impl<E: Experiment> Campaign<E> {
    /// Runs what the arguments say, or reads the results of `--from`. Writes the result file
    /// of `--json`.
    ///
    /// # Errors
    ///
    /// A unit can't be run, or a file can't be read or written.
    pub fn obtain(experiment: E, arguments: &CampaignArgs) -> Result<Self> {
        if !arguments.from.is_empty() {
            return Self::read(&arguments.from);
        }
        let shard = arguments.shard.unwrap_or(Shard::WHOLE);
        if let Some(path) = &arguments.json {
            // Before hours of work.
            ResultFile::check_writable(path)?;
        }
        let units: Vec<u64> = shard.units(experiment.units()).collect();
        let work = |unit| experiment.run(unit);
        let results = run_shown(E::NAME, &units, arguments.threads(), work)?;
        if let Some(path) = &arguments.json {
            let header = Header::of(&experiment, shard)?;
            ResultFile::of(header, &results)?.write(path)?;
        }
        Ok(Self {
            experiment,
            shard,
            results,
        })
    }

    /// Reads the files of all shards of a campaign.
    fn read(paths: &[PathBuf]) -> Result<Self> {
        let file = merge_files(paths)?;
        let other = |reason: String| {
            let path = paths.first().cloned().unwrap_or_default();
            let path = path.display();
            format!("{path}: {reason}; this is a report about {:?}", E::NAME)
        };
        let campaign = &file.header.campaign;
        if campaign != E::NAME {
            return Err(other(format!("it has results of {campaign:?}")).into());
        }
        let experiment = serde_json::from_value(file.header.options.clone());
        let experiment = experiment.map_err(|error| other(format!("its options: {error}")))?;
        let results = file
            .parsed()
            .map_err(|error| other(format!("another version wrote it: {error}")))?;
        Ok(Self {
            experiment,
            shard: Shard::WHOLE,
            results,
        })
    }
}

/// Options of a command that runs a campaign.
#[derive(Clone, Debug, Default, Args)]
pub struct CampaignArgs {
    /// Run part K of N only, K from 1 to N: on N machines, or as a job array
    #[arg(long, value_name = "K/N")]
    pub shard: Option<Shard>,

    /// Write the results to this file, for `singletrack merge` and --from
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Run nothing: report the results in the files of all shards, or in the merged one.
    /// The options that decide the results are those of the files.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["shard", "json"])]
    pub from: Vec<PathBuf>,

    /// Number of threads; does not affect the results [default: one per core]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

impl CampaignArgs {
    /// The number of threads to use.
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(thread_count).max(1)
    }
}

/// Interval of the lines in a log.
const LINE_INTERVAL: Duration = Duration::from_secs(60);

/// Runs units as [`run_units`] does, with a bar on a terminal, and a line a minute in a log, as the job
/// of a cluster has it.
///
/// # Errors
///
/// The first error of `work`.
pub fn run_shown<R: Send, E: Send>(
    name: &str,
    units: &[u64],
    threads: usize,
    work: impl Fn(u64) -> Result<R, E> + Sync,
) -> Result<Vec<(u64, R)>, E> {
    let bar = ProgressBar::new(units.len() as u64);
    let template = "{bar:30} {pos}/{len}, {per_sec}, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    let is_log = !io::stderr().is_terminal();
    let next_line = Mutex::new(Instant::now() + LINE_INTERVAL);
    let results = run_units(units, threads, work, || {
        bar.inc(1);
        let mut next = next_line.lock().unwrap_or_else(PoisonError::into_inner);
        if is_log && Instant::now() >= *next {
            *next += LINE_INTERVAL;
            let (done, all, seconds) = (bar.position(), units.len(), bar.elapsed().as_secs_f64());
            let line = format!("{name}: {done} of {all} after {seconds:.0} s");
            // Standard error may be closed.
            let _ = writeln!(io::stderr().lock(), "{line}");
        }
    });
    bar.finish_and_clear();
    results
}
