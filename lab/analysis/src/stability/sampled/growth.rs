//! The growth of the powers of a matrix.

use nalgebra::DMatrix;

/// The growth of the powers of a matrix by repeated squaring: `‖M^k‖^(1/k)`, which tends to
/// the spectral radius for every matrix (Gelfand).
struct Squaring {
    power: DMatrix<f64>,
    /// Logarithm of the divisor of `power`, over the exponent.
    logarithm: f64,
    exponent: f64,
}

/// Number of squarings.
const SQUARINGS: usize = 40;

impl Squaring {
    fn new(matrix: DMatrix<f64>) -> Self {
        let mut squaring = Self {
            power: matrix,
            logarithm: 0.0,
            exponent: 1.0,
        };
        squaring.normalise();
        squaring
    }

    fn normalise(&mut self) {
        let norm = self.power.norm();
        if norm > 0.0 {
            self.power /= norm;
        }
        self.logarithm += libm::log(norm) / self.exponent;
    }

    fn square(&mut self) {
        self.power = &self.power * &self.power;
        self.exponent *= 2.0;
        self.normalise();
    }
}

pub(super) fn spectral_radius(matrix: DMatrix<f64>) -> f64 {
    let mut squaring = Squaring::new(matrix);
    for _ in 0..SQUARINGS {
        if !squaring.logarithm.is_finite() {
            break;
        }
        squaring.square();
    }
    libm::exp(squaring.logarithm)
}

/// Whether the spectral radius is below one: some power then has a norm below one.
pub(super) fn is_stable(matrix: DMatrix<f64>) -> bool {
    let mut squaring = Squaring::new(matrix);
    for _ in 0..SQUARINGS {
        if squaring.logarithm < 0.0 {
            return true;
        }
        squaring.square();
    }
    false
}
