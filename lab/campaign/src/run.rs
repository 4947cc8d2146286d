//! Runs a campaign, or reads its results.

use core::error::Error;
use std::path::PathBuf;

use crate::{
    experiment::CampaignArgs,
    experiment::{Experiment, Results},
    file::{FileError, Header, ResultFile},
    merge::{MergeError, merge_files},
    progress::Progress,
    shard::Shard,
    units::run_units,
};

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
