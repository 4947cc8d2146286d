//! An experiment of a campaign, and how it is run.

use core::{error::Error, fmt::Debug};
use std::path::PathBuf;

use clap::Args;
use serde::{Serialize, de::DeserializeOwned};

use crate::{shard::Shard, units::thread_count};

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
    #[must_use]
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(thread_count).max(1)
    }
}

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

/// Results of the units of a shard, in the order of their numbers.
pub type Results<E> = Vec<(u64, <E as Experiment>::Result)>;
