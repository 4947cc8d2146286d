//! Runs the units of an experiment on all cores.

use core::{error::Error, fmt::Debug, num::NonZero};
use std::{
    path::PathBuf,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use serde::{Serialize, de::DeserializeOwned};

use crate::{
    arguments::CampaignArgs,
    file::{FileError, Header, ResultFile},
    merge::{MergeError, merge_files},
    progress::Progress,
    shard::Shard,
};

/// An experiment of numbered units. What it serialises to must decide all results, and
/// nothing else may: it is compared when files are merged.
pub trait Experiment: Serialize + DeserializeOwned + Sync {
    /// Its name in the files.
    const NAME: &'static str;

    /// The result of a unit.
    type Result: Serialize + DeserializeOwned + Debug + Send;

    /// Why a unit has no result.
    type Error: Error + Send + 'static;

    /// The number of units.
    fn units(&self) -> u64;

    /// Files besides this program that decide the results.
    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    /// Runs a unit, on any thread.
    ///
    /// # Errors
    ///
    /// The unit can't be run; the campaign ends.
    fn run(&self, unit: u64) -> Result<Self::Result, Self::Error>;
}

/// Why a campaign has no results.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError<E: Error + 'static> {
    /// A unit can't be run.
    #[error(transparent)]
    Unit(E),
    /// The result file can't be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// Result files can't be read or don't belong together.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// The files are of another experiment, or another version wrote them.
    #[error("{}: {reason}; this is a report about {expected:?}", path.display())]
    Other {
        /// The first file.
        path: PathBuf,
        /// What differs.
        reason: String,
        /// The experiment that was expected.
        expected: &'static str,
    },
}

/// Results of the units of a shard, in the order of their numbers.
pub type Results<E> = Vec<(u64, <E as Experiment>::Result)>;

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
    pub fn obtain(
        experiment: E,
        arguments: &CampaignArgs,
    ) -> Result<Self, CampaignError<E::Error>> {
        if !arguments.from.is_empty() {
            return Self::read(&arguments.from);
        }
        let shard = arguments.shard.unwrap_or(Shard::WHOLE);
        if let Some(path) = &arguments.json {
            // Before hours of work.
            ResultFile::check_writable(path)?;
        }
        let units: Vec<u64> = shard.units(experiment.units()).collect();
        let progress = Progress::new(E::NAME, units.len() as u64);
        let results = run_units(
            &units,
            arguments.threads(),
            |unit| experiment.run(unit),
            || progress.advance(),
        );
        progress.finish();
        let results = results.map_err(CampaignError::Unit)?;
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
    fn read(paths: &[PathBuf]) -> Result<Self, CampaignError<E::Error>> {
        let file = merge_files(paths)?;
        let other = |reason| CampaignError::Other {
            path: paths.first().cloned().unwrap_or_default(),
            reason,
            expected: E::NAME,
        };
        if file.header.campaign != E::NAME {
            return Err(other(format!(
                "it has results of {:?}",
                file.header.campaign
            )));
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

/// Runs units on some threads and returns the results in the order of `units`. `progress` is
/// called after each, from any thread.
///
/// # Errors
///
/// The error of the first unit, in the order of `units`, that failed. The others are not
/// begun any more.
pub fn run_units<R: Send, E: Send>(
    units: &[u64],
    threads: usize,
    work: impl Fn(u64) -> Result<R, E> + Sync,
    progress: impl Fn() + Sync,
) -> Result<Vec<(u64, R)>, E> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::with_capacity(units.len()));
    let worker = || {
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(&unit) = units.get(place) else {
                return;
            };
            let result = work(unit);
            if result.is_err() {
                next.store(units.len(), Ordering::Relaxed);
            }
            results
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push((place, unit, result));
            progress();
        }
    };
    thread::scope(|scope| {
        for _ in 0..threads.min(units.len()).max(1) {
            scope.spawn(worker);
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(place, ..)| *place);
    let results = results.into_iter();
    results
        .map(|(_, unit, result)| Ok((unit, result?)))
        .collect()
}

/// One thread per core that this process may use.
#[must_use]
pub fn thread_count() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_results_are_in_order_on_any_number_of_threads() {
        let units: Vec<u64> = (0..100).rev().collect();
        let run = |threads| run_units(&units, threads, |unit| Ok::<_, ()>(unit * unit), || ());
        let one = run(1).unwrap();
        assert_eq!(one.first(), Some(&(99, 99 * 99)));
        assert_eq!(one.len(), units.len());
        for threads in [0, 3, 200] {
            assert_eq!(run(threads).unwrap(), one);
        }
    }

    #[test]
    fn the_first_failure_ends_the_campaign() {
        let units: Vec<u64> = (0..1_000_000).collect();
        let fail = |unit| if unit < 10 { Ok(()) } else { Err(unit) };
        assert_eq!(run_units(&units, 4, fail, || ()), Err(10));
    }
}
