//! Least squares over blocks of a drive, with the jackknife's deviations.

use heapless::Deque;
use libm::sqrt;
use nalgebra::{SMatrix, SVector};

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
