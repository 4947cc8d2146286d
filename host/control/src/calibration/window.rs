//! Weighted means over windows of a drive.
//!
//! The weight φ(u) = (1 − u²)² vanishes at both ends of a window, with its slope. Integration by
//! parts then moves derivatives from the noisy signals to the weight: the mean of a derivative of
//! ψ' is that of −φ' ψ'.

/// The longest time between two samples of a signal, s.
const LONGEST_GAP: f64 = 0.08;

/// Largest difference of a sum of weights from their integral, as a fraction.
const COVERAGE: f64 = 0.05;

/// Windows that are open at a time: they overlap by half, and samples are under way.
const OPEN: usize = 4;

/// The longest that poses and telemetry are under way, s.
const UNDER_WAY: f64 = 0.25;

/// Sums of `N` signals with the weight and its slope, of which signals that come together share
/// the weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sums<const N: usize> {
    weights: f64,
    values: [f64; N],
    slopes: [f64; N],
}

/// The means of signals, and those of their derivatives.
pub(super) type Means<const N: usize> = ([f64; N], [f64; N]);

impl<const N: usize> Sums<N> {
    const fn new() -> Self {
        Self {
            weights: 0.0,
            values: [0.0; N],
            slopes: [0.0; N],
        }
    }

    /// Adds integrals of the signals from `from` to `until`, in s after the begin of a window of
    /// this length.
    fn add(&mut self, length: f64, from: f64, until: f64, integrals: [f64; N]) {
        let u = (from + until) / length - 1.0;
        let inside = 1.0 - u * u;
        if inside <= 0.0 {
            return;
        }
        let weight = inside * inside;
        let slope = -8.0 * u * inside / length;
        self.weights += weight * (until - from);
        for (index, integral) in integrals.into_iter().enumerate() {
            self.values[index] += weight * integral;
            self.slopes[index] -= slope * integral;
        }
    }

    /// The means; none if samples are missing.
    fn means(&self, length: f64) -> Option<Means<N>> {
        let share = self.weights / (length * 8.0 / 15.0);
        ((share - 1.0).abs() < COVERAGE).then(|| {
            let mean = |sum: f64| sum / self.weights;
            (self.values.map(mean), self.slopes.map(mean))
        })
    }
}

/// The windows of a signal, or of signals that come together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Windows<const N: usize> {
    length: f64,
    /// The open windows, each at its number modulo their count.
    open: [Sums<N>; OPEN],
    last: Option<(f64, [f64; N])>,
}

impl<const N: usize> Windows<N> {
    /// Windows of this length, s.
    pub(super) const fn new(length: f64) -> Self {
        Self {
            length,
            open: [Sums::new(); OPEN],
            last: None,
        }
    }

    /// Takes the values of the signals at `time`, s; `first` is the first open window.
    pub(super) fn take(&mut self, first: u64, time: f64, values: [f64; N]) {
        if let Some((then, before)) = self.last.replace((time, values))
            && follows(then, time)
        {
            let span = time - then;
            let integrals =
                core::array::from_fn(|index| 0.5 * (before[index] + values[index]) * span);
            self.add(first, then, time, integrals);
        }
    }

    /// Adds integrals of the signals between two times, s.
    pub(super) fn add(&mut self, first: u64, from: f64, until: f64, integrals: [f64; N]) {
        for number in first..first + OPEN as u64 {
            let begin = begin(self.length, number);
            self.open[slot(number)].add(self.length, from - begin, until - begin, integrals);
        }
    }

    /// The signals are interrupted.
    pub(super) const fn interrupt(&mut self) {
        self.last = None;
    }

    /// The means of the first open window, whose place the one after the last takes.
    pub(super) fn close(&mut self, first: u64) -> Option<Means<N>> {
        let sums = core::mem::replace(&mut self.open[slot(first)], Sums::new());
        sums.means(self.length)
    }

    /// Forgets all windows.
    pub(super) fn clear(&mut self) {
        self.open = [Sums::new(); OPEN];
    }
}

/// When a window begins, s.
pub(super) fn begin(length: f64, number: u64) -> f64 {
    0.5 * length * number as f64
}

/// The window that must be the first open one at `now`, s.
pub(super) fn first_open(length: f64, now: f64) -> u64 {
    let closed = (now - UNDER_WAY - length) / (0.5 * length) + 1.0;
    closed.max(0.0) as u64
}

/// Whether windows from `first` to `next` are more than those that are open.
pub(super) const fn is_gap(first: u64, next: u64) -> bool {
    next - first > OPEN as u64
}

const fn slot(number: u64) -> usize {
    (number % OPEN as u64) as usize
}

/// Whether samples at these times, in s, follow each other without a gap.
pub(super) fn follows(from: f64, until: f64) -> bool {
    until > from && until - from <= LONGEST_GAP
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENGTH: f64 = 0.6;

    #[test]
    fn means_are_those_of_the_signal_and_of_its_derivative() {
        let mut windows = Windows::new(LENGTH);
        let signal = |t: f64| 3.0 * t * t + 2.0 * t + 5.0;
        for sample in 0..80 {
            let time = 0.01 * f64::from(sample) - 0.033;
            windows.take(0, time, [signal(time)]);
        }
        assert_eq!(first_open(LENGTH, 0.84), 0);
        assert_eq!(first_open(LENGTH, 0.86), 1);
        let ([mean], [derivative]) = windows.close(0).unwrap();
        // The weight has the variance L²/28.
        let expected = signal(0.3) + 3.0 * LENGTH * LENGTH / 28.0;
        assert!((mean - expected).abs() < 1e-3, "{mean}");
        assert!((derivative - 3.8).abs() < 1e-2, "{derivative}");
        assert_eq!(windows.close(1), None);
    }

    #[test]
    fn a_window_with_a_gap_has_no_means() {
        let mut windows = Windows::new(LENGTH);
        for sample in (0..80).filter(|sample| !(25..35).contains(sample)) {
            windows.take(0, 0.01 * f64::from(sample), [1.0]);
        }
        assert_eq!(windows.close(0), None);
    }
}
