//! Campaigns: many independent runs of one experiment, over the cores of one machine or as
//! shards over many.
//!
//! An [`Experiment`] numbers its runs, the *units*, from 0. A unit's result depends on the
//! experiment and the unit's number alone. So the results are the same, to the bit, on any
//! number of threads and in any number of shards.
//!
//! A shard writes a [`ResultFile`]: a header with everything that decides the results, then a
//! line per unit. [`merge_files`] joins the files of all shards to the file that one process
//! writes, byte for byte, and refuses gaps, doubles, and files of different campaigns.
//!
//! ```text
//! singletrack-faults --count 10000 --shard 1/4 --json faults-1.jsonl     on four machines
//! singletrack merge faults-*.jsonl --out faults.jsonl
//! singletrack-faults --from faults.jsonl                                 the report
//! ```

mod campaign;
mod shard;

pub use campaign::{
    Campaign, CampaignArgs, FORMAT, Header, MergeArgs, ResultFile, merge_files, run_merge,
    run_shown,
};
pub use shard::{Experiment, Results, Shard, ShardError, run_units, thread_count};

/// A value, or a sentence for the user about why there is none.
pub type Result<T = (), E = Box<dyn core::error::Error + Send + Sync>> = core::result::Result<T, E>;
