//! How often messages arrive.

/// The longest time between two arrivals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gap {
    /// Its length, in ns.
    pub longest_ns: i64,
    /// When it began, in ns.
    pub begin_ns: i64,
}

impl Gap {
    /// A gap of no length, which began at 0.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            longest_ns: 0,
            begin_ns: 0,
        }
    }

    /// Takes the gap from `begin_ns` to `end_ns` if it is longer.
    pub fn add(&mut self, begin_ns: i64, end_ns: i64) {
        if end_ns - begin_ns > self.longest_ns {
            *self = Self {
                longest_ns: end_ns - begin_ns,
                begin_ns,
            };
        }
    }
}

/// Count, rate and longest gap of arrivals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrivals {
    count: u64,
    first_ns: i64,
    last_ns: i64,
    gap: Gap,
}

impl Arrivals {
    /// Adds an arrival, in ns; without a time it counts as simultaneous with the latest.
    pub fn add(&mut self, time_ns: Option<i64>) {
        let time_ns = time_ns.unwrap_or(self.last_ns);
        if self.count == 0 {
            self.first_ns = time_ns;
            self.gap.begin_ns = time_ns;
        } else {
            self.gap.add(self.last_ns, time_ns);
        }
        self.count += 1;
        self.last_ns = self.last_ns.max(time_ns);
    }

    /// The number of arrivals.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Arrivals per second between the first and the latest; none if no time passed.
    #[must_use]
    pub fn rate_hz(&self) -> Option<f64> {
        let span_s = (self.last_ns - self.first_ns) as f64 / 1e9;
        (self.count > 1 && span_s > 0.0).then(|| (self.count - 1) as f64 / span_s)
    }

    /// The time of the first arrival, in ns.
    #[must_use]
    pub fn first_ns(&self) -> Option<i64> {
        (self.count > 0).then_some(self.first_ns)
    }

    /// The time of the latest arrival, in ns.
    #[must_use]
    pub fn last_ns(&self) -> Option<i64> {
        (self.count > 0).then_some(self.last_ns)
    }

    /// The longest time between two arrivals; none with fewer than two.
    #[must_use]
    pub fn longest_gap(&self) -> Option<Gap> {
        (self.count > 1).then_some(self.gap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_count_for_the_rate_and_the_longest_is_the_gap() {
        let mut arrivals = Arrivals::default();
        for ms in [10, 20, 50, 60] {
            arrivals.add(Some(ms * 1_000_000));
        }
        assert_eq!(arrivals.count(), 4);
        assert_eq!(arrivals.rate_hz(), Some(60.0));
        assert_eq!(arrivals.first_ns(), Some(10_000_000));
        assert_eq!(arrivals.last_ns(), Some(60_000_000));
        assert_eq!(
            arrivals.longest_gap(),
            Some(Gap {
                longest_ns: 30_000_000,
                begin_ns: 20_000_000
            })
        );
    }

    #[test]
    fn a_single_arrival_has_neither_rate_nor_gap() {
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.first_ns(), None);
        arrivals.add(Some(5));
        assert_eq!((arrivals.rate_hz(), arrivals.longest_gap()), (None, None));
        arrivals.add(None);
        assert_eq!(arrivals.rate_hz(), None);
        assert_eq!(arrivals.last_ns(), Some(5));
    }
}
