//! The closed loop linearised at its steady motion, and its eigenvalues.

use nalgebra::{Complex, DMatrix, Schur};
use num_dual::Dual64;

use super::{
    closed_loop::{ClosedLoop, Law},
    vector_field::{FrontPointField, VectorField, VelocityPointField},
};

/// The eigenvalues of a steady motion: three or four.
pub type Eigenvalues = heapless::Vec<Complex<f64>, 4>;

/// Limit of the steps of the QR algorithm, more than a matrix of this size needs.
pub(super) const MOST_STEPS: usize = 10_000;

impl ClosedLoop {
    /// The Jacobian of the steady motion, by exact derivatives, in rad and s: four by four for
    /// the states yaw, yaw rate, sideslip and steering, or three by three without steering
    /// under the velocity-point law.
    #[must_use]
    pub fn jacobian(&self) -> DMatrix<f64> {
        match self.law {
            Law::FrontPoint => jacobian(&FrontPointField(self)),
            Law::VelocityPoint => jacobian(&VelocityPointField(self)),
        }
    }

    /// The eigenvalues of the steady motion, in 1/s: four under the front-point law, three under
    /// the velocity-point law.
    ///
    /// By ascending real part; of a complex pair the one with the negative imaginary part is
    /// first. They are those of the Jacobian by the QR algorithm, polished on the characteristic
    /// polynomial, which has no roundings of large entries; not numbers if that does not converge.
    #[must_use]
    pub fn eigenvalues(&self) -> Eigenvalues {
        let polynomial = self.characteristic_polynomial();
        let schur = Schur::try_new(self.jacobian(), f64::EPSILON, MOST_STEPS);
        let mut eigenvalues: Eigenvalues = match schur {
            Some(schur) => {
                let found = schur.complex_eigenvalues();
                let polished = found.iter().map(|root| polynomial.polished(*root));
                polished.collect()
            }
            None => {
                let unknown = Complex::new(f64::NAN, f64::NAN);
                polynomial.coefficients().iter().map(|_| unknown).collect()
            }
        };
        eigenvalues.sort_unstable_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
        eigenvalues
    }
}

/// The Jacobian at the steady motion, by exact derivatives.
fn jacobian<const N: usize>(field: &impl VectorField<N>) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(N, N);
    for column in 0..N {
        let mut state = [Dual64::from(0.0); N];
        if let Some(state) = state.get_mut(column) {
            state.eps = 1.0;
        }
        let slope = field.slope(state).map(|slope| slope.eps);
        jacobian.column_mut(column).copy_from_slice(&slope);
    }
    jacobian
}
