//! The options that every campaign has.

use std::path::PathBuf;

use clap::Args;

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
