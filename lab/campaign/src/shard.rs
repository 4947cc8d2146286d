//! Which units of a campaign a process runs.

use core::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

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
    #[must_use]
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
}
