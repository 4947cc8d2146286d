//! Punctuality of the ticks.

use singletrack_control::Time;

use super::config::WatchConfig;

/// Measures gaps and missed ticks from the times of the ticks alone.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TickWatch {
    last: Option<Time>,
    /// The time between the last two ticks, s.
    gap: f64,
    /// Ticks missed, less `max_missed` for each second since.
    missed: f64,
}

impl TickWatch {
    /// A tick at `now`. Punctual ticks are one `period` (s) apart.
    pub(crate) fn tick(&mut self, now: Time, period: f64, config: &WatchConfig) {
        let Some(last) = self.last.replace(now) else {
            return;
        };
        self.gap = now.seconds_since(last);
        // A tick that is late by less than half a period counts as punctual.
        let missed = libm::floor(self.gap / period - 0.5).max(0.0);
        let limit = f64::from(config.max_missed);
        let forgiven = self.gap * limit;
        // The cap makes a pause of any length expire a second after it.
        self.missed = ((self.missed - forgiven).max(0.0) + missed).min(2.0 * limit);
    }

    /// Whether the last gap was longer than `max_gap`, or more than `max_missed` ticks
    /// were missed in about a second.
    pub(crate) fn is_late(&self, config: &WatchConfig) -> bool {
        self.gap > config.max_gap || self.missed > f64::from(config.max_missed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the watch is late after each tick, for these intervals in ms.
    fn late(intervals: impl IntoIterator<Item = u64>) -> std::vec::Vec<bool> {
        let config = WatchConfig::paper();
        let mut watch = TickWatch::default();
        let mut now = Time(1_000_000_000);
        watch.tick(now, 0.01, &config);
        intervals
            .into_iter()
            .map(|interval| {
                now = Time(now.0 + interval * 1_000_000);
                watch.tick(now, 0.01, &config);
                watch.is_late(&config)
            })
            .collect()
    }

    #[test]
    fn one_long_gap_is_late_until_the_next_tick() {
        assert_eq!(
            late([10, 80, 10, 81, 10]),
            [false, false, false, true, false]
        );
    }

    #[test]
    fn a_long_pause_expires_a_second_later() {
        let late = late([5_000].into_iter().chain([10; 200]));
        let last = late.iter().rposition(|late| *late).unwrap();
        assert!((98..=101).contains(&last), "{last}");
    }

    #[test]
    fn the_allowed_number_of_ticks_may_be_missed_at_once() {
        let config = WatchConfig {
            max_gap: 1.0,
            ..WatchConfig::paper()
        };
        for (missed, late) in [(20, false), (21, true)] {
            let mut watch = TickWatch::default();
            watch.tick(Time(1_000_000_000), 0.01, &config);
            watch.tick(
                Time(1_000_000_000 + (missed + 1) * 10_000_000),
                0.01,
                &config,
            );
            assert_eq!(watch.is_late(&config), late, "{missed}");
        }
    }

    #[test]
    fn jitter_of_less_than_half_a_period_is_never_late() {
        assert!(!late((0..10_000).map(|i| if i % 2 == 0 { 6 } else { 14 })).contains(&true));
    }

    #[test]
    fn a_sixth_of_the_ticks_may_be_missed_and_half_may_not() {
        // 60 ms for 5 ticks: one sixth is missed, 16.7 per second.
        let sixth = (0..1_000).map(|i| if i % 5 == 0 { 20 } else { 10 });
        assert!(!late(sixth).contains(&true));
        let half = late([20; 200]);
        let first = half.iter().position(|late| *late).unwrap();
        // 50 missed per second, of which 20 expire: 20 after 0.67 s.
        assert!((32..=34).contains(&first), "{first}");
        assert!(half[first..].iter().all(|late| *late));
    }
}
