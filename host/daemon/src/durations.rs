//! Percentiles of durations in a fixed amount of memory, however long the daemon runs.

use hdrhistogram::Histogram;
use serde::Serialize;

/// Significant decimal digits of the buckets: each is at most 1 % wide.
const DIGITS: u8 = 2;

/// The longest duration with a bucket of its own size, in ns: 292 years.
const LONGEST_NS: u64 = i64::MAX as u64;

/// Percentiles of durations, in microseconds; zeros without durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Half of the values are at most this; rounded up by at most 1 %.
    pub p50: f64,
    /// 99 % of the values are at most this; rounded up by at most 1 %.
    pub p99: f64,
    /// The largest value, exactly.
    pub max: f64,
}

/// A histogram of durations in nanoseconds, in buckets of at most 1 %. It allocates
/// about 60 kB when it is made and nothing afterwards.
#[derive(Clone, Debug)]
pub(crate) struct DurationHistogram {
    buckets: Histogram<u64>,
    /// The bucket of the largest value only bounds it.
    max_ns: u64,
}

impl Default for DurationHistogram {
    #[expect(clippy::expect_used, reason = "the arguments are constants and valid")]
    fn default() -> Self {
        Self {
            buckets: Histogram::new_with_max(LONGEST_NS, DIGITS).expect("valid arguments"),
            max_ns: 0,
        }
    }
}

impl DurationHistogram {
    /// Adds a duration, in ns.
    pub(crate) fn add(&mut self, ns: u64) {
        self.buckets.saturating_record(ns);
        self.max_ns = self.max_ns.max(ns);
    }

    /// The percentiles of all durations so far.
    pub(crate) fn percentiles(&self) -> Percentiles {
        let microseconds = |ns: u64| ns as f64 / 1_000.0;
        Percentiles {
            p50: microseconds(self.quantile_ns(0.5)),
            p99: microseconds(self.quantile_ns(0.99)),
            max: microseconds(self.max_ns),
        }
    }

    fn quantile_ns(&self, part: f64) -> u64 {
        // The end of a bucket, which may lie beyond every value in it.
        self.buckets.value_at_quantile(part).min(self.max_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket_and_buckets_are_narrow() {
        for ns in (0..63).flat_map(|bits| {
            let power = 1_u64 << bits;
            [power - 1, power, power + power / 3, power + (power - 1)]
        }) {
            let mut histogram = DurationHistogram::default();
            histogram.add(ns);
            let end = histogram.buckets.value_at_quantile(0.5);
            assert!(end >= ns, "{ns}");
            assert!((end - ns) as f64 <= 0.01 * ns as f64, "{ns}");
            assert_eq!(histogram.quantile_ns(0.5), ns);
        }
    }

    #[test]
    fn longer_durations_saturate_and_the_largest_stays_exact() {
        let mut histogram = DurationHistogram::default();
        histogram.add(u64::MAX);
        let Percentiles { p50, p99, max } = histogram.percentiles();
        assert_eq!(p50, p99);
        assert!(p50 >= LONGEST_NS as f64 / 1_000.0, "{p50}");
        assert_eq!(max, u64::MAX as f64 / 1_000.0);
    }

    #[test]
    fn percentiles_are_those_of_the_values() {
        let mut histogram = DurationHistogram::default();
        assert_eq!(histogram.percentiles(), Percentiles::default());
        for us in 1..=1_000_u64 {
            histogram.add(us * 1_000);
        }
        let Percentiles { p50, p99, max } = histogram.percentiles();
        assert!((500.0..505.0).contains(&p50), "{p50}");
        assert!((990.0..=1_000.0).contains(&p99), "{p99}");
        assert_eq!(max, 1_000.0);
    }
}
