//! How regular the times of a source are.

/// The share of a message's jitter that moves the next exposure: the clocks of cameras and log drift.
pub(super) const FOLLOWED: f64 = 0.02;

/// The jitter from which exposures that are regular are worth the key, in s; and the share of a period
/// up to which the times can be those of regular exposures.
const WORTH: f64 = 2e-4;
const REGULAR: f64 = 0.3;
/// The finest grid of stamps that is told, and how well the stamps must lie on it, in s.
const FINEST: f64 = 5e-4;
const ON_GRID: f64 = 1.5e-4;

/// The rate of a source, and what is irregular in its times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// Samples per second: one over the median of the intervals.
    pub rate_hz: f64,
    /// Root mean square of the times' distances from regular ones, in s.
    pub jitter_s: f64,
    /// The step of a grid on which all times lie, if it is coarse, in s.
    pub grid_s: Option<f64>,
}

impl Times {
    /// The statistics of times in order, in ns; none for fewer than ten.
    pub(super) fn of(times_ns: &[u64]) -> Option<Self> {
        let intervals = times_ns.windows(2).map(|pair| pair[1] - pair[0]);
        let intervals: Vec<f64> = intervals.map(|ns| ns as f64 * 1e-9).collect();
        if intervals.len() < 10 {
            return None;
        }
        let mean = mean_period(&intervals)?;
        Some(Self {
            rate_hz: 1.0 / mean,
            jitter_s: jitter(&intervals, mean),
            grid_s: grid(&intervals),
        })
    }

    /// The rate of regular exposures that these times may be, if that is worth a key.
    pub fn exposures_hz(&self) -> Option<u32> {
        let rate = self.rate_hz.round();
        let is_whole = (self.rate_hz - rate).abs() < 0.01 * rate;
        let is_jitter = self.jitter_s > WORTH && self.jitter_s < REGULAR / self.rate_hz;
        (is_whole && is_jitter).then_some(rate as u32)
    }
}

/// The mean of the intervals that are about one period: a gap is none.
fn mean_period(intervals: &[f64]) -> Option<f64> {
    let mut sorted = intervals.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied()?;
    let about = 0.4 * median..1.6 * median;
    let whole = intervals.iter().copied().filter(|it| about.contains(it));
    let whole: Vec<f64> = whole.collect();
    let mean = whole.iter().sum::<f64>() / whole.len() as f64;
    (mean > 0.0).then_some(mean)
}

/// Distances from regular times that follow the clock slowly, as the import's exposures do.
fn jitter(intervals: &[f64], period: f64) -> f64 {
    let (mut off, mut squares, mut count) = (0.0, 0.0, 0.0);
    for interval in intervals {
        let periods = (interval / period).round().max(1.0);
        off += interval - periods * period;
        if off.abs() > 0.5 * period {
            off = 0.0;
        }
        squares += off * off;
        count += 1.0;
        off -= FOLLOWED * off;
    }
    f64::sqrt(squares / f64::max(count, 1.0))
}

/// The step of which all intervals are multiples, if they are few ones.
fn grid(intervals: &[f64]) -> Option<f64> {
    let mut sorted = intervals.to_vec();
    sorted.sort_by(f64::total_cmp);
    // The levels on which the intervals lie.
    let mut levels: Vec<(f64, usize)> = Vec::new();
    for interval in sorted {
        match levels.last_mut() {
            Some((level, count)) if interval - *level < 2.0 * ON_GRID => {
                *level += (interval - *level) / (*count as f64 + 1.0);
                *count += 1;
            }
            _ => levels.push((interval, 1)),
        }
    }
    // Strays are none.
    levels.retain(|(_, count)| 100 * count > intervals.len());
    let steps = levels.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let step = steps.min_by(f64::total_cmp)?;
    let lies = |level: f64| (level - (level / step).round() * step).abs() < 2.0 * ON_GRID;
    let covers = levels.iter().map(|(_, count)| count).sum::<usize>() * 100 > 95 * intervals.len();
    (step > FINEST && covers && levels.iter().all(|(level, _)| lies(*level))).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(step: impl Fn(u32) -> f64) -> Times {
        let times: Vec<u64> = (0..500).map(|n| (1e9 * (1.0 + step(n))) as u64).collect();
        Times::of(&times).unwrap()
    }

    #[test]
    fn stamps_on_a_coarse_grid_are_told_and_their_exposures_proposed() {
        let on_grid = times(|n| (f64::from(n) * 0.01 * 360.0).round() / 360.0);
        assert!(
            (on_grid.grid_s.unwrap() * 360.0 - 1.0).abs() < 0.02,
            "{on_grid:?}"
        );
        assert_eq!(on_grid.exposures_hz(), Some(100));
    }

    #[test]
    fn regular_times_and_lost_samples_need_no_key() {
        let regular = times(|n| f64::from(n + n / 100 * 7) * 0.01);
        assert!(regular.jitter_s < 1e-6, "{regular:?}");
        assert_eq!((regular.exposures_hz(), regular.grid_s), (None, None));
        assert_eq!(Times::of(&[0, 1, 2]), None);
    }
}
