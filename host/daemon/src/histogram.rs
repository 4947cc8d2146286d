//! A histogram of durations, with buckets of at most 1.6 % of their value.

use serde::Serialize;

/// Buckets per power of two. Below this many nanoseconds, each value has its own bucket.
const FINE: u64 = 64;
const FINE_BITS: u32 = FINE.ilog2();
/// The number of buckets for every `u64`.
const BUCKETS: usize = ((64 - FINE_BITS + 1) as usize) * FINE as usize;

/// Durations in nanoseconds.
#[derive(Clone, Debug)]
pub(crate) struct Histogram {
    counts: Vec<u64>,
    count: u64,
    max_ns: u64,
}

/// Percentiles of durations, in microseconds; zeros without values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// The median, to 1.6 %.
    pub p50: f64,
    /// The 99th percentile, to 1.6 %.
    pub p99: f64,
    /// The largest value.
    pub max: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            counts: vec![0; BUCKETS],
            count: 0,
            max_ns: 0,
        }
    }
}

impl Histogram {
    pub(crate) fn add(&mut self, ns: u64) {
        if let Some(count) = self.counts.get_mut(bucket(ns)) {
            *count += 1;
        }
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    pub(crate) fn percentiles(&self) -> Percentiles {
        let microseconds = |ns: u64| ns as f64 / 1_000.0;
        Percentiles {
            p50: microseconds(self.quantile(50)),
            p99: microseconds(self.quantile(99)),
            max: microseconds(self.max_ns),
        }
    }

    /// The end of the bucket of this percentile.
    fn quantile(&self, percent: u64) -> u64 {
        let rank = (self.count * percent).div_ceil(100);
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return end(bucket).min(self.max_ns);
            }
        }
        self.max_ns
    }
}

fn bucket(ns: u64) -> usize {
    if ns < FINE {
        return ns as usize;
    }
    let shift = ns.ilog2() - FINE_BITS;
    // The shifted value is at least FINE and below 2 FINE.
    ((u64::from(shift) + 1) * FINE + (ns >> shift) - FINE) as usize
}

/// The largest value of a bucket.
fn end(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < FINE {
        return bucket;
    }
    let shift = bucket / FINE - 1;
    let first = (bucket % FINE + FINE) << shift;
    first + ((1 << shift) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket_and_buckets_are_narrow() {
        for ns in (0..64).flat_map(|bits| {
            let power = 1_u64 << bits;
            [power - 1, power, power + power / 3, power + (power - 1)]
        }) {
            let bucket = bucket(ns);
            assert!(bucket < BUCKETS);
            assert!(end(bucket) >= ns, "{ns}");
            assert!(bucket == 0 || end(bucket - 1) < ns, "{ns}");
            assert!((end(bucket) - ns) as f64 <= 0.016 * ns as f64, "{ns}");
        }
    }

    #[test]
    fn percentiles_agree_with_the_values() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.percentiles(), Percentiles::default());
        for us in 1..=1_000_u64 {
            histogram.add(us * 1_000);
        }
        let Percentiles { p50, p99, max } = histogram.percentiles();
        assert!((500.0..508.0).contains(&p50), "{p50}");
        assert!((990.0..=1_000.0).contains(&p99), "{p99}");
        assert_eq!(max, 1_000.0);
    }
}
