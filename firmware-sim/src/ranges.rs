//! The ranges of the settings.

use singletrack_settings::{Worded, in_words};

/// Any number.
pub(crate) const FINITE: Worded = in_words("finite", |_| true);
/// Above zero.
pub(crate) const POSITIVE: Worded = in_words("finite and above zero", |x| x > 0.0);
/// Zero or above.
pub(crate) const NOT_NEGATIVE: Worded = in_words("finite and not negative", |x| x >= 0.0);
/// A probability.
pub(crate) const PROBABILITY: Worded =
    in_words("a probability from 0 to 1", |x| (0.0..=1.0).contains(&x));
/// A rate of edges, per second.
pub(crate) const EDGE_RATE: Worded =
    in_words("between 0 and 100000", |x| (0.0..=100_000.0).contains(&x));
/// The time constant of a lag, in s: the integrator's step is a millisecond.
pub(crate) const LAG: Worded = in_words("0.002 or more", |x| x >= 0.002);
/// A period, in µs.
pub(crate) const PERIOD: Worded = in_words("1000 or more", |x| x >= 1_000.0);
