//! From the signals of a drive to its parameters: weighted means over windows, which make equations, and
//! least squares over blocks of them, with the jackknife's deviations.
//!
//! The weight φ(u) = (1 − u²)² vanishes at both ends of a window, with its slope. Integration by
//! parts then moves derivatives from the noisy signals to the weight: the mean of a derivative of
//! ψ' is that of −φ' ψ'.

use heapless::Deque;
use libm::sqrt;
use nalgebra::{SMatrix, SVector};

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

/// Blocks kept: the memory of a regression.
const BLOCKS: usize = 64;

/// Blocks without which nothing is fitted.
const LEAST_BLOCKS: usize = 6;

/// A block with fewer equations is dropped.
const LEAST_EQUATIONS: u32 = 3;

/// The normal equations of some time of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Block<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    right: SVector<f64, N>,
    count: u32,
}

impl<const N: usize> Block<N> {
    fn new() -> Self {
        Self {
            matrix: SMatrix::zeros(),
            right: SVector::zeros(),
            count: 0,
        }
    }

    fn add(&mut self, other: &Self) {
        self.matrix += other.matrix;
        self.right += other.right;
        self.count += other.count;
    }

    /// These equations without a parameter whose value is known.
    fn holding(&self, held: Option<(usize, f64)>) -> Self {
        let mut block = *self;
        if let Some((index, value)) = held {
            block.right -= value * self.matrix.column(index);
            block.right[index] = 0.0;
            block.matrix.row_mut(index).fill(0.0);
            block.matrix.column_mut(index).fill(0.0);
        }
        block
    }
}

/// A regression with `N` parameters.
///
/// Residuals are correlated, by play and by what the model lacks. The deviations are therefore
/// those of the estimates without one block of the drive at a time (the jackknife), and a block
/// is longer than the correlation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Regression<const N: usize> {
    blocks: Deque<Block<N>, BLOCKS>,
    open: Block<N>,
}

/// What a regression says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit<const N: usize> {
    pub(super) values: SVector<f64, N>,
    /// Half widths of intervals of 95 %.
    pub(super) half_widths: SVector<f64, N>,
    /// Root mean square of each regressor, without its part along the others: the least without
    /// one block, for a start from standstill is no drive.
    pub(super) excitation: SVector<f64, N>,
}

impl<const N: usize> Regression<N> {
    pub(super) fn new() -> Self {
        Self {
            blocks: Deque::new(),
            open: Block::new(),
        }
    }

    /// Adds the equation `regressors` · parameters = `value`.
    pub(super) fn add(&mut self, regressors: SVector<f64, N>, value: f64) {
        if value.is_finite() && regressors.iter().all(|x| x.is_finite()) {
            self.open.matrix += regressors * regressors.transpose();
            self.open.right += value * regressors;
            self.open.count += 1;
        }
    }

    /// How the equations of the open block contradict these parameters, as a change of the
    /// one at `index`; `None` if they are too few.
    pub(super) fn contradiction(&self, index: usize, values: &SVector<f64, N>) -> Option<f64> {
        let open = &self.open;
        let rest = open.right - open.matrix * values;
        (open.count >= LEAST_EQUATIONS).then(|| rest[index] / open.matrix[(index, index)])
    }

    /// Forgets the blocks, but not the open one.
    pub(super) fn forget(&mut self) {
        self.blocks.clear();
    }

    /// Ends the open block without taking it.
    pub(super) fn drop_block(&mut self) {
        self.open = Block::new();
    }

    /// Ends the open block.
    pub(super) fn end_block(&mut self) {
        let block = core::mem::replace(&mut self.open, Block::new());
        if block.count < LEAST_EQUATIONS {
            return;
        }
        if self.blocks.is_full() {
            self.blocks.pop_front();
        }
        // There is room.
        let _ = self.blocks.push_back(block);
    }

    /// The fit, with the value of at most one parameter given; `None` without enough blocks, or
    /// with regressors that depend on each other.
    pub(super) fn fit(&self, held: Option<(usize, f64)>) -> Option<Fit<N>> {
        let count = self.blocks.len();
        if count < LEAST_BLOCKS {
            return None;
        }
        let mut whole = Block::new();
        for block in &self.blocks {
            whole.add(&block.holding(held));
        }
        if let Some((index, value)) = held {
            whole.matrix[(index, index)] = 1.0;
            whole.right[index] = value;
        }
        let inverse = whole.matrix.cholesky()?.inverse();
        let values = inverse * whole.right;
        let mut squares = SVector::<f64, N>::zeros();
        let mut excitation = SVector::<f64, N>::repeat(f64::INFINITY);
        for block in &self.blocks {
            let block = block.holding(held);
            let without = (whole.matrix - block.matrix).cholesky()?.inverse();
            let change = without * (whole.right - block.right) - values;
            squares += change.component_mul(&change);
            let count = f64::from(whole.count - block.count);
            let excited = without.diagonal().map(|it| sqrt(1.0 / (count * it)));
            excitation = excitation.inf(&excited);
        }
        let blocks = count as f64;
        let t = student_quantile(count.saturating_sub(N));
        Some(Fit {
            values,
            half_widths: squares.map(|sum| t * sqrt(sum * (blocks - 1.0) / blocks)),
            excitation,
        })
    }
}

/// 97.5 % quantiles of Student's distribution, by degrees of freedom, from one.
const STUDENT: [f64; 30] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056,
    2.052, 2.048, 2.045, 2.042,
];

/// The 97.5 % quantile of Student's distribution with `freedom` degrees of freedom, to 0.001: half the
/// width of a 95 % interval, in standard errors. Infinite without a degree of freedom.
pub fn student_quantile(freedom: usize) -> f64 {
    let Some(index) = freedom.checked_sub(1) else {
        return f64::INFINITY;
    };
    STUDENT.get(index).copied().unwrap_or_else(|| {
        let inverse = 1.0 / freedom as f64;
        1.96 + inverse * (2.37 + 2.82 * inverse)
    })
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

    #[test]
    fn quantiles_are_those_of_the_tables() {
        assert_eq!(student_quantile(0), f64::INFINITY);
        for (freedom, quantile) in [(1, 12.706), (4, 2.776), (31, 2.040), (60, 2.000)] {
            assert!((student_quantile(freedom) - quantile).abs() < 0.001);
        }
        assert!((student_quantile(100_000) - 1.96).abs() < 0.001);
    }

    #[test]
    fn a_line_is_found_and_its_deviation_is_that_of_the_noise() {
        let mut line = Regression::<2>::new();
        let mut noise = 0.37;
        for index in 0..320 {
            let x = f64::from(index % 40) / 20.0 - 1.0;
            noise = (noise * 997.0 + 0.123) % 1.0;
            line.add(SVector::from([x, 1.0]), 2.0 * x - 0.5 + 0.1 * (noise - 0.5));
            if index % 16 == 15 {
                line.end_block();
            }
        }
        let fit = line.fit(None).unwrap();
        assert!((fit.values[0] - 2.0).abs() < 0.01 && (fit.values[1] + 0.5).abs() < 0.01);
        // 0.1 / sqrt(12) / (0.58 sqrt(320)), twice.
        assert!((0.002..0.012).contains(&fit.half_widths[0]), "{fit:?}");
        assert!((fit.excitation[0] - 0.577).abs() < 0.02, "{fit:?}");
        let held = line.fit(Some((1, -0.5))).unwrap();
        assert!((held.values[0] - 2.0).abs() < 0.01 && held.values[1] == -0.5);
        assert_eq!(held.half_widths[1], 0.0);
    }

    #[test]
    fn dependent_regressors_and_a_short_drive_give_nothing() {
        let mut same = Regression::<2>::new();
        for index in 0..320 {
            same.add(SVector::from([1.0, 1.0]), 2.0);
            if index % 16 == 15 {
                same.end_block();
            }
        }
        assert!(same.fit(None).is_none_or(|fit| fit.excitation[0] < 1e-3));
        assert!(Regression::<2>::new().fit(None).is_none());
    }
}
