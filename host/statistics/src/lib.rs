//! Percentiles, root mean squares, lines and rates of measured values, for the daemon, the
//! commissioning, the analysis, the command line and the tests; and [`Random`] numbers from a seed.
//!
//! Every percentile is a nearest-rank percentile: the smallest value that a given part
//! of all values does not exceed.
//!
//! [`Distribution`] keeps every value and is exact. [`DurationHistogram`] needs a fixed
//! amount of memory, however long the daemon runs, and rounds up by at most 1 %.

mod arrivals;
mod distribution;
mod duration_histogram;
mod line;
mod random;
mod root_mean_square;

pub use arrivals::{Arrivals, Gap};
pub use distribution::Distribution;
pub use duration_histogram::{DurationHistogram, Percentiles};
pub use line::Line;
pub use random::Random;
pub use root_mean_square::RootMeanSquare;
