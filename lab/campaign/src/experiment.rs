//! What a campaign runs.

use core::{error::Error, fmt::Debug};
use std::path::PathBuf;

use serde::{Serialize, de::DeserializeOwned};

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
