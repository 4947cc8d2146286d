//! Whether the controller keeps time.

use super::WatchConfig;
use singletrack_control::Time;

/// Judges by the times of the ticks alone.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TickWatch {
    last: Option<Time>,
    gap: f64,
    /// Ticks missed, less those that time has forgiven.
    missed: f64,
}

impl TickWatch {
    /// A tick at `now`, a `period` (s) after the one before if it is punctual.
    pub(crate) fn tick(&mut self, now: Time, period: f64, config: &WatchConfig) {
        let Some(last) = self.last.replace(now) else {
            return;
        };
        self.gap = now.seconds_since(last);
        // A tick that is late by less than half a period has missed nothing.
        let missed = libm::floor(self.gap / period - 0.5).max(0.0);
        let limit = f64::from(config.max_missed);
        let forgiven = self.gap * limit;
        // However long a pause was, it is forgiven a second after it.
        self.missed = ((self.missed - forgiven).max(0.0) + missed).min(2.0 * limit);
    }

    /// Whether the last tick came too long after the one before, or too many
    /// were missed of late.
    pub(crate) fn is_late(&self, config: &WatchConfig) -> bool {
        self.gap > config.max_gap || self.missed > f64::from(config.max_missed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks at these intervals, in ms; whether it is late after each.
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
    fn one_long_gap_is_late_and_over_with_the_next_tick() {
        assert_eq!(
            late([10, 80, 10, 81, 10]),
            [false, false, false, true, false]
        );
    }

    #[test]
    fn a_long_pause_is_forgiven_a_second_later() {
        let late = late([5_000].into_iter().chain([10; 200]));
        let last = late.iter().rposition(|late| *late).unwrap();
        assert!((98..=101).contains(&last), "{last}");
    }

    #[test]
    fn as_many_ticks_as_allowed_may_be_missed_at_once() {
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
    fn jitter_is_never_late_however_long_it_lasts() {
        assert!(!late((0..10_000).map(|i| if i % 2 == 0 { 6 } else { 14 })).contains(&true));
    }

    #[test]
    fn a_sixth_of_the_ticks_may_be_missed_and_a_half_may_not() {
        // 60 ms for 5 ticks: a sixth is missed, 16.7 a second.
        let sixth = (0..1_000).map(|i| if i % 5 == 0 { 20 } else { 10 });
        assert!(!late(sixth).contains(&true));
        let half = late([20; 200]);
        let first = half.iter().position(|late| *late).unwrap();
        // 50 missed a second, of which 20 are forgiven: 20 after 0.67 s.
        assert!((32..=34).contains(&first), "{first}");
        assert!(half[first..].iter().all(|late| *late));
    }
}
