//! An experiment of numbered units, and which of them a process runs, on all cores.

use core::{fmt, num::NonZero, str::FromStr};
use std::{
    path::PathBuf,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Part `index` of `of` of a campaign; the parts are numbered from 1.
///
/// The units are dealt out in turn, so that all parts have their share of units that take
/// long.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Shard {
    index: u64,
    of: u64,
}

/// A text that names no part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "give the part and the number of parts as K/N, with K from 1 to N: 1/4 is the first of four"
)]
pub struct ShardError;

impl Shard {
    /// The whole campaign.
    pub const WHOLE: Self = Self { index: 1, of: 1 };

    /// Part `index` of `of`.
    ///
    /// # Errors
    ///
    /// `index` is not between 1 and `of`.
    pub const fn new(index: u64, of: u64) -> Result<Self, ShardError> {
        if index == 0 || index > of {
            return Err(ShardError);
        }
        Ok(Self { index, of })
    }

    /// The part of `of` that has a unit; `of` is at least 1.
    pub(crate) const fn with_unit(unit: u64, of: u64) -> Self {
        Self {
            index: unit % of + 1,
            of,
        }
    }

    /// Number of parts.
    pub const fn of(self) -> u64 {
        self.of
    }

    /// Its units, of the `count` units of a campaign, in order.
    pub fn units(self, count: u64) -> impl Iterator<Item = u64> + Clone {
        let steps = usize::try_from(self.of).unwrap_or(usize::MAX);
        (self.index - 1..count).step_by(steps)
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let (index, of) = text.split_once('/').ok_or(ShardError)?;
        let number = |text: &str| text.parse().map_err(|_| ShardError);
        Self::new(number(index)?, number(of)?)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}/{}", self.index, self.of)
    }
}

impl TryFrom<String> for Shard {
    type Error = ShardError;

    fn try_from(text: String) -> Result<Self, ShardError> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
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
pub fn thread_count() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

/// An experiment of numbered units. What it serialises to must decide all results, and
/// nothing else may: it is compared when files are merged.
pub trait Experiment: Serialize + DeserializeOwned + Sync {
    /// Its name in the files.
    const NAME: &'static str;

    /// The result of a unit.
    type Result: Serialize + DeserializeOwned + fmt::Debug + Send;

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
    fn run(&self, unit: u64) -> crate::Result<Self::Result>;
}

/// Results of the units of a shard, in the order of their numbers.
pub type Results<E> = Vec<(u64, <E as Experiment>::Result)>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_have_every_unit_once_and_differ_by_one_at_most() {
        for count in [0, 1, 7, 100] {
            for of in [1, 2, 3, 7, 150] {
                let mut units = Vec::new();
                for index in 1..=of {
                    let shard = Shard::new(index, of).unwrap();
                    let own: Vec<u64> = shard.units(count).collect();
                    assert!(own.iter().all(|&unit| Shard::with_unit(unit, of) == shard));
                    assert!(own.len() as u64 <= count.div_ceil(of));
                    units.extend(own);
                }
                units.sort_unstable();
                assert_eq!(units, (0..count).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn what_names_no_part_is_refused() {
        for text in [
            "", "1", "0/4", "5/4", "1/0", "-1/4", "1/4/4", "a/b", "1/ 4", "1.5/4",
        ] {
            assert_eq!(text.parse::<Shard>(), Err(ShardError), "{text}");
        }
        let shard: Shard = "3/4".parse().unwrap();
        assert_eq!(shard, Shard::new(3, 4).unwrap());
        assert_eq!(shard.to_string(), "3/4");
    }

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
