//! The closed loop linearised at its steady motion, and its eigenvalues.

use nalgebra::{Complex, DMatrix, Matrix3, Matrix4, SMatrix, SVector};
use num_dual::Dual64;

use super::{
    ClosedLoop, Law,
    vector_field::{FrontPointField, VectorField, VelocityPointField},
};

impl ClosedLoop {
    /// The Jacobian of the steady motion, by exact derivatives: four by four for the
    /// states yaw, yaw rate, sideslip, steering; three by three without steering
    /// under the velocity-point law. In rad and s.
    #[must_use]
    pub fn jacobian(&self) -> DMatrix<f64> {
        match self.law {
            Law::FrontPoint => DMatrix::from_iterator(4, 4, self.front_point().iter().copied()),
            Law::VelocityPoint => {
                DMatrix::from_iterator(3, 3, self.velocity_point().iter().copied())
            }
        }
    }

    /// The eigenvalues of the steady motion, in 1/s, by ascending real part, of a
    /// complex pair the one with the negative imaginary part first: four under the
    /// front-point law, three under the velocity-point law.
    #[must_use]
    pub fn eigenvalues(&self) -> Vec<Complex<f64>> {
        let mut eigenvalues: Vec<_> = match self.law {
            Law::FrontPoint => self
                .front_point()
                .complex_eigenvalues()
                .iter()
                .copied()
                .collect(),
            Law::VelocityPoint => self
                .velocity_point()
                .complex_eigenvalues()
                .iter()
                .copied()
                .collect(),
        };
        eigenvalues.sort_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
        eigenvalues
    }

    fn front_point(&self) -> Matrix4<f64> {
        jacobian(&FrontPointField(self))
    }

    fn velocity_point(&self) -> Matrix3<f64> {
        jacobian(&VelocityPointField(self))
    }
}

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
