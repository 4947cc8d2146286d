//! The closed loop linearised at its steady motion, and its eigenvalues.

use nalgebra::{Complex, DMatrix, Matrix3, Matrix4, SMatrix, SVector, Schur};
use num_dual::Dual64;

use super::{
    characteristic::CharacteristicPolynomial,
    closed_loop::{ClosedLoop, Law},
    roots,
    vector_field::{FrontPointField, VectorField, VelocityPointField},
};

/// The eigenvalues of a steady motion: three or four.
pub type Eigenvalues = heapless::Vec<Complex<f64>, 4>;

impl ClosedLoop {
    /// The Jacobian of the steady motion, by exact derivatives, in rad and s: four by four for
    /// the states yaw, yaw rate, sideslip and steering, or three by three without steering
    /// under the velocity-point law.
    #[must_use]
    pub fn jacobian(&self) -> DMatrix<f64> {
        match self.law {
            Law::FrontPoint => DMatrix::from_iterator(4, 4, self.front_point().iter().copied()),
            Law::VelocityPoint => {
                DMatrix::from_iterator(3, 3, self.velocity_point().iter().copied())
            }
        }
    }

    /// The eigenvalues of the steady motion, in 1/s: four under the front-point law, three under
    /// the velocity-point law.
    ///
    /// By ascending real part; of a complex pair the one with the negative imaginary part is
    /// first. They are the roots of the characteristic polynomial in closed form, or, where
    /// its factors are too close to each other, the eigenvalues of the Jacobian by the QR
    /// algorithm; not numbers if that does not converge.
    #[must_use]
    pub fn eigenvalues(&self) -> Eigenvalues {
        let found = match self.characteristic_polynomial() {
            CharacteristicPolynomial::Quartic(a) => {
                roots::quartic(a).map(|found| found.into_iter().collect())
            }
            CharacteristicPolynomial::Cubic(a) => {
                roots::cubic(a).map(|found| found.into_iter().collect())
            }
        };
        let mut eigenvalues: Eigenvalues = found.unwrap_or_else(|| self.eigenvalues_by_qr());
        eigenvalues.sort_unstable_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
        eigenvalues
    }

    /// The eigenvalues of the Jacobian, in no order.
    fn eigenvalues_by_qr(&self) -> Eigenvalues {
        let unknown = || Complex::new(f64::NAN, f64::NAN);
        match self.law {
            Law::FrontPoint => Schur::try_new(self.front_point(), f64::EPSILON, MOST_STEPS)
                .map_or_else(
                    || [unknown(); 4].into_iter().collect(),
                    |schur| schur.complex_eigenvalues().iter().copied().collect(),
                ),
            Law::VelocityPoint => Schur::try_new(self.velocity_point(), f64::EPSILON, MOST_STEPS)
                .map_or_else(
                    || [unknown(); 3].into_iter().collect(),
                    |schur| schur.complex_eigenvalues().iter().copied().collect(),
                ),
        }
    }

    fn front_point(&self) -> Matrix4<f64> {
        jacobian(&FrontPointField(self))
    }

    fn velocity_point(&self) -> Matrix3<f64> {
        jacobian(&VelocityPointField(self))
    }
}

/// Limit of the steps of the QR algorithm, more than a matrix of this size needs.
const MOST_STEPS: usize = 10_000;

/// The Jacobian at the origin.
fn jacobian<const N: usize>(field: &impl VectorField<N>) -> SMatrix<f64, N, N> {
    let mut jacobian = SMatrix::<f64, N, N>::zeros();
    for column in 0..N {
        let mut state = [Dual64::from(0.0); N];
        if let Some(state) = state.get_mut(column) {
            state.eps = 1.0;
        }
        let slope = field.slope(state);
        jacobian.set_column(column, &SVector::from(slope.map(|slope| slope.eps)));
    }
    jacobian
}
