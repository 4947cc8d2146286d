//! The discrete algebraic Riccati equation, and the gain of the linear-quadratic regulator.

use nalgebra::SMatrix;

/// The largest number of doublings: 2^50 steps of the closed loop.
const DOUBLINGS: usize = 50;
/// The closed loop counts as settled when its power is this much smaller than one.
const SETTLED: f64 = 1e-13;
/// A residual beyond this share of the solution is not a solution.
const RESIDUAL: f64 = 1e-9;

/// The system x⁺ = A x + B u with the cost of one step xᵀQx + uᵀRu.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadraticRegulator<const N: usize, const M: usize> {
    /// The state's own motion, A.
    pub transition: SMatrix<f64, N, N>,
    /// The effect of the input, B.
    pub input: SMatrix<f64, N, M>,
    /// The weight of the state, Q: symmetric, positive semidefinite.
    pub state_weight: SMatrix<f64, N, N>,
    /// The weight of the input, R: symmetric, positive definite.
    pub input_weight: SMatrix<f64, M, M>,
}

/// The solution of the Riccati equation: u = -K x has the least cost, x₀ᵀXx₀.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulated<const N: usize, const M: usize> {
    /// The cost matrix X.
    pub cost: SMatrix<f64, N, N>,
    /// The gain K.
    pub gain: SMatrix<f64, M, N>,
}

/// Why there is no regulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RiccatiError {
    /// A number is infinite or NaN.
    #[error("a matrix of the regulator holds a number that is not finite")]
    NotFinite,
    /// The weight of the input can't be inverted.
    #[error("the weight of the input is not positive definite")]
    InputWeight,
    /// The pair (A, B) can't be stabilised, or a mode on the unit circle has no weight.
    #[error(
        "no gain makes the system settle: it can't be stabilised, or a mode that does not settle has no weight"
    )]
    NotStabilisable,
}

impl<const N: usize, const M: usize> QuadraticRegulator<N, M> {
    /// Solves A'XA - X - A'XB (R + B'XB)⁻¹ B'XA + Q = 0 for the stabilising X.
    ///
    /// The structure-preserving doubling algorithm (Chu, Fan, Lin, Wang 2004): each
    /// iteration doubles the number of steps that the cost covers. The closed loop after all
    /// those steps comes out as well, and that it vanishes proves the gain to be stabilising.
    ///
    /// # Errors
    ///
    /// See [`RiccatiError`].
    pub fn solve(&self) -> Result<Regulated<N, M>, RiccatiError> {
        let finite = self.transition.iter().chain(self.input.iter());
        let weights = self.state_weight.iter().chain(self.input_weight.iter());
        if !finite.chain(weights).all(|number| number.is_finite()) {
            return Err(RiccatiError::NotFinite);
        }
        if self.input_weight.cholesky().is_none() {
            return Err(RiccatiError::InputWeight);
        }
        let weighted =
            solve(&self.input_weight, &self.input.transpose()).ok_or(RiccatiError::InputWeight)?;
        let identity = SMatrix::<f64, N, N>::identity();
        // The closed loop's power, its controllability and its cost.
        let mut power = self.transition;
        let mut reach = symmetric(&product(&self.input, &weighted));
        let mut cost = symmetric(&self.state_weight);
        let mut settled = false;
        for _ in 0..DOUBLINGS {
            let mixed = identity + product(&reach, &cost);
            let advanced = solve(&mixed, &power).ok_or(RiccatiError::NotStabilisable)?;
            let reached = solve(&mixed, &reach).ok_or(RiccatiError::NotStabilisable)?;
            let added = product(&power.transpose(), &product(&cost, &advanced));
            reach = symmetric(&(reach + product(&power, &product(&reached, &power.transpose()))));
            cost = symmetric(&(cost + added));
            power = product(&power, &advanced);
            if !cost.iter().all(|number| number.is_finite()) {
                return Err(RiccatiError::NotStabilisable);
            }
            if power.amax() < SETTLED {
                settled = true;
                break;
            }
        }
        let gain = self.gain(&cost).ok_or(RiccatiError::NotStabilisable)?;
        let solved = Regulated { cost, gain };
        if settled && self.residual(&solved) <= RESIDUAL * (1.0 + cost.amax()) {
            Ok(solved)
        } else {
            Err(RiccatiError::NotStabilisable)
        }
    }

    /// The largest entry of the Riccati equation's left side at `solution`.
    pub fn residual(&self, solution: &Regulated<N, M>) -> f64 {
        let closed = self.transition - product(&self.input, &solution.gain);
        let kept = product(
            &self.transition.transpose(),
            &product(&solution.cost, &closed),
        );
        (kept + self.state_weight - solution.cost).amax()
    }

    /// K = (R + B'XB)⁻¹ B'XA.
    fn gain(&self, cost: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, M, N>> {
        let onto = product(&self.input.transpose(), cost);
        solve(
            &(self.input_weight + product(&onto, &self.input)),
            &product(&onto, &self.transition),
        )
    }
}

/// The product, summed in the order of the columns.
///
/// nalgebra hands larger products to kernels that use what the processor offers, whose bits
/// differ from machine to machine.
pub(crate) fn product<const R: usize, const K: usize, const C: usize>(
    left: &SMatrix<f64, R, K>,
    right: &SMatrix<f64, K, C>,
) -> SMatrix<f64, R, C> {
    SMatrix::from_fn(|row, column| {
        (0..K).fold(0.0, |sum, inner| {
            sum + left[(row, inner)] * right[(inner, column)]
        })
    })
}

/// The symmetric part of a matrix.
pub(crate) fn symmetric<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    0.5 * (matrix + matrix.transpose())
}

/// The solution of `matrix` x = `right` by Gaussian elimination with partial pivoting; none if
/// the matrix is singular.
fn solve<const N: usize, const C: usize>(
    matrix: &SMatrix<f64, N, N>,
    right: &SMatrix<f64, N, C>,
) -> Option<SMatrix<f64, N, C>> {
    let (mut left, mut right) = (*matrix, *right);
    for pivot in 0..N {
        let largest = (pivot..N).reduce(|best, row| {
            if left[(row, pivot)].abs() > left[(best, pivot)].abs() {
                row
            } else {
                best
            }
        })?;
        left.swap_rows(pivot, largest);
        right.swap_rows(pivot, largest);
        let divisor = left[(pivot, pivot)];
        if divisor == 0.0 || !divisor.is_finite() {
            return None;
        }
        for row in pivot + 1..N {
            let share = left[(row, pivot)] / divisor;
            for column in pivot..N {
                left[(row, column)] -= share * left[(pivot, column)];
            }
            for column in 0..C {
                right[(row, column)] -= share * right[(pivot, column)];
            }
        }
    }
    for row in (0..N).rev() {
        for column in 0..C {
            let known = (row + 1..N).fold(0.0, |sum, inner| {
                sum + left[(row, inner)] * right[(inner, column)]
            });
            right[(row, column)] = (right[(row, column)] - known) / left[(row, row)];
        }
    }
    Some(right)
}
