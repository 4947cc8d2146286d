//! The limits of the sampled loop: the first unstable speed, and the least distance p.
//!
//! In continuous time both follow from a quadratic (see
//! [`critical_speed`](super::critical_speed)). With sampling, delay and a servo they are
//! searched for.

use nalgebra::{Complex, DMatrix, Schur};
use num_dual::Dual64;

use super::{
    closed_loop::{ClosedLoop, Law, StabilityError},
    sampled::SampledLoop,
    vector_field::{FrontPointField, VectorField, VelocityPointField},
};

/// The ratio of two values of the search: narrower regions are not found.
const RATIO: f64 = 1.05;
/// The relative resolution of the result.
const RESOLUTION: f64 = 1e-6;

/// The lowest speed in m/s from which the motion is unstable with one of `deviations` (dl, m),
/// between the ends of a range above zero. None if it is stable throughout; the
/// first speed if it is unstable there.
///
/// # Errors
///
/// A speed or a deviation without a steady motion.
pub fn first_unstable_speed(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    boundary(from, to, |speed| {
        let at = sampled.closed_loop.with_speed(speed)?;
        is_stable(sampled, at, deviations)
    })
}

/// The least distance p in m from which on the motion is stable with each of `deviations` (dl,
/// m), between the ends of a range above zero. None if it is unstable at the last
/// one; the first one if it is stable throughout.
///
/// # Errors
///
/// A distance or a deviation without a steady motion.
pub fn least_point_distance(
    sampled: &SampledLoop,
    deviations: &[f64],
    [from, to]: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    let is_stable = |p: f64| {
        let at = sampled.closed_loop.with_point_distance(p)?;
        is_stable(sampled, at, deviations)
    };
    if !is_stable(to)? {
        return Ok(None);
    }
    // From the largest distance down.
    Ok(Some(boundary(to, from, is_stable)?.unwrap_or(from)))
}

fn is_stable(
    sampled: &SampledLoop,
    at: ClosedLoop,
    deviations: &[f64],
) -> Result<bool, StabilityError> {
    for deviation in deviations {
        if !sampled.around(at.with_deviation(*deviation)?).is_stable() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where, on the way from `from` to `to`, the motion is no longer stable.
fn boundary(
    from: f64,
    to: f64,
    is_stable: impl Fn(f64) -> Result<bool, StabilityError>,
) -> Result<Option<f64>, StabilityError> {
    if !is_stable(from)? {
        return Ok(Some(from));
    }
    let steps = (libm::fabs(libm::log(to / from)) / libm::log(RATIO))
        .ceil()
        .max(1.0) as u32;
    let at = |step: u32| from * libm::pow(to / from, f64::from(step) / f64::from(steps));
    let mut stable = from;
    for step in 1..=steps {
        let mut unstable = at(step);
        if is_stable(unstable)? {
            stable = unstable;
            continue;
        }
        while libm::fabs(unstable - stable) > RESOLUTION * stable {
            let middle = 0.5 * (stable + unstable);
            if is_stable(middle)? {
                stable = middle;
            } else {
                unstable = middle;
            }
        }
        return Ok(Some(0.5 * (stable + unstable)));
    }
    Ok(None)
}

/// The eigenvalues of a steady motion: three or four.
pub type Eigenvalues = Vec<Complex<f64>>;

/// Limit of the steps of the QR algorithm, more than a matrix of this size needs.
pub(super) const MOST_STEPS: usize = 10_000;

impl ClosedLoop {
    /// The Jacobian of the steady motion, by exact derivatives, in rad and s: four by four for
    /// the states yaw, yaw rate, sideslip and steering, or three by three without steering
    /// under the velocity-point law.
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
    pub fn eigenvalues(&self) -> Eigenvalues {
        let polynomial = self.characteristic_polynomial();
        let schur = Schur::try_new(self.jacobian(), f64::EPSILON, MOST_STEPS);
        let mut eigenvalues: Eigenvalues = match schur {
            Some(schur) => {
                let found = schur.complex_eigenvalues();
                found
                    .iter()
                    .map(|root| polynomial.polished(*root))
                    .collect()
            }
            None => vec![Complex::new(f64::NAN, f64::NAN); polynomial.coefficients().len()],
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
        state[column].eps = 1.0;
        let slope = field.slope(state).map(|slope| slope.eps);
        jacobian.column_mut(column).copy_from_slice(&slope);
    }
    jacobian
}
