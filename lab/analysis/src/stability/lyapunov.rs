//! The first Lyapunov coefficient of a Hopf bifurcation, by exact derivatives.
//!
//! With the Jacobian A, its eigenvector `A q = i ω q`, the adjoint one `Aᵀ p = -i ω p`,
//! `|q| = 1`, `⟨p, q⟩ = 1`, and the second and third derivatives of the vector field as
//! multilinear forms B and C, Kuznetsov (*Elements of Applied Bifurcation Theory*,
//! equation 5.39 in the third edition) has
//!
//! ```text
//! l₁ = Re( ⟨p, C(q, q, q̄)⟩ - 2 ⟨p, B(q, A⁻¹ B(q, q̄))⟩ + ⟨p, B(q̄, (2 i ω - A)⁻¹ B(q, q))⟩ ) / (2 ω)
//! ```
//!
//! (The straight steady motion is its own mirror image, so that B is zero there. It is
//! computed nevertheless.)

use core::array::from_fn;

use nalgebra::{Complex, DMatrix, DVector};
use num_dual::{HyperDual64, HyperHyperDual64};

use super::{
    closed_loop::{ClosedLoop, Law},
    vector_field::{FrontPointField, VectorField, VelocityPointField},
};

/// The first Lyapunov coefficient, for the states in rad and rad/s. If it is positive, the
/// Hopf bifurcation is subcritical.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lyapunov {
    /// In Kuznetsov's normalisation.
    pub kuznetsov: f64,
    /// The coefficient that `MatCont` prints: ω times Kuznetsov's.
    pub matcont: f64,
}

type Vector = DVector<Complex<f64>>;

impl Lyapunov {
    /// The coefficient of a loop whose Jacobian has the eigenvalue i `frequency`. None if the
    /// Jacobian is singular or nearly so.
    pub(super) fn of(closed_loop: &ClosedLoop, frequency: f64) -> Option<Self> {
        let jacobian = closed_loop.jacobian();
        let kuznetsov = match closed_loop.law {
            Law::FrontPoint => kuznetsov(&FrontPointField(closed_loop), &jacobian, frequency),
            Law::VelocityPoint => kuznetsov(&VelocityPointField(closed_loop), &jacobian, frequency),
        }
        .filter(|coefficient| coefficient.is_finite())?;
        Some(Self {
            kuznetsov,
            matcont: frequency * kuznetsov,
        })
    }
}

fn kuznetsov<const N: usize>(
    field: &impl VectorField<N>,
    jacobian: &DMatrix<f64>,
    frequency: f64,
) -> Option<f64> {
    let a = jacobian.map(|entry| Complex::new(entry, 0.0));
    let i_omega = Complex::new(0.0, frequency);
    let identity = DMatrix::identity(N, N);
    let q = null_vector(&a - &identity * i_omega)?;
    let p = null_vector(a.transpose() + &identity * i_omega)?;
    // ⟨p, q⟩ = p̄ᵀ q.
    let p = &p / p.dotc(&q).conj();

    let conjugate = q.conjugate();
    let mean = a.clone().lu().solve(&second(field, &q, &conjugate))?;
    let double = (identity * (i_omega * 2.0) - a)
        .lu()
        .solve(&second(field, &q, &q))?;
    let sum = p.dotc(&third(field, &q)) - p.dotc(&second(field, &q, &mean)) * 2.0
        + p.dotc(&second(field, &conjugate, &double));
    Some(sum.re / (2.0 * frequency))
}

/// The unit vector in the kernel of a singular matrix, by inverse iteration.
pub(super) fn null_vector(matrix: DMatrix<Complex<f64>>) -> Option<Vector> {
    /// Off the eigenvalue by this much of the matrix, so that the solution exists. Each step
    /// divides the share of the other eigenvectors by their distance over this.
    const SHIFT: f64 = 1e-12;
    let size = matrix.nrows();
    let shift = Complex::new(SHIFT * matrix.norm(), 0.0);
    let lu = (matrix + DMatrix::identity(size, size) * shift).lu();
    // Along no eigenvector of a mirrored motion.
    let mut vector = Vector::from_fn(size, |row, _| Complex::new(1.0, 0.3 * row as f64));
    for _ in 0..3 {
        vector = lu.solve(&vector)?;
        vector /= Complex::new(vector.norm(), 0.0);
    }
    vector
        .iter()
        .all(|entry| entry.re.is_finite() && entry.im.is_finite())
        .then_some(vector)
}

/// B(u, v): the second derivatives along two complex directions.
fn second<const N: usize>(field: &impl VectorField<N>, u: &Vector, v: &Vector) -> Vector {
    let along = |u: &[f64; N], v: &[f64; N]| {
        let state = from_fn(|row| HyperDual64::new(0.0, u[row], v[row], 0.0));
        field.slope(state).map(|slope| slope.eps1eps2)
    };
    let ([ur, ui], [vr, vi]) = (parts(u), parts(v));
    let [rr, ii] = [along(&ur, &vr), along(&ui, &vi)];
    let [ri, ir] = [along(&ur, &vi), along(&ui, &vr)];
    Vector::from_fn(N, |row, _| {
        Complex::new(rr[row] - ii[row], ri[row] + ir[row])
    })
}

/// C(q, q, q̄): with q = a + i b it is C(a, a, a) + C(a, b, b) + i (C(a, a, b) + C(b, b, b)).
fn third<const N: usize>(field: &impl VectorField<N>, q: &Vector) -> Vector {
    let along = |u: &[f64; N], v: &[f64; N], w: &[f64; N]| {
        let state = from_fn(|row| {
            let mut state = HyperHyperDual64::from(0.0);
            (state.eps1, state.eps2, state.eps3) = (u[row], v[row], w[row]);
            state
        });
        field.slope(state).map(|slope| slope.eps1eps2eps3)
    };
    let [a, b] = parts(q);
    let [aaa, abb] = [along(&a, &a, &a), along(&a, &b, &b)];
    let [aab, bbb] = [along(&a, &a, &b), along(&b, &b, &b)];
    Vector::from_fn(N, |row, _| {
        Complex::new(aaa[row] + abb[row], aab[row] + bbb[row])
    })
}

/// The real and the imaginary part.
fn parts<const N: usize>(vector: &Vector) -> [[f64; N]; 2] {
    [from_fn(|row| vector[row].re), from_fn(|row| vector[row].im)]
}

#[cfg(test)]
mod tests {
    use singletrack_control::VehicleParameters;

    use super::*;
    use crate::stability::{Belief, HopfPoint, hopf_points};

    /// The growth rate of the amplitude of an oscillation, in 1/s, and its mean square, from an
    /// integration of the vector field.
    fn simulated_growth<const N: usize>(
        field: &impl VectorField<N>,
        jacobian: &DMatrix<f64>,
        frequency: f64,
        amplitude: f64,
    ) -> [f64; 2] {
        let a = jacobian.map(|entry| Complex::new(entry, 0.0));
        let i_omega = Complex::new(0.0, frequency);
        let identity = DMatrix::identity(N, N);
        let q = null_vector(&a - &identity * i_omega).unwrap();
        let p = null_vector(a.transpose() + &identity * i_omega).unwrap();
        let p = &p / p.dotc(&q).conj();

        let [mut state, _] = parts::<N>(&(&q * Complex::new(2.0 * amplitude, 0.0)));
        let fastest = jacobian.norm();
        let period = 2.0 * core::f64::consts::PI / frequency;
        let steps = (period * fastest).ceil().max(400.0) as usize;
        let step = period / steps as f64;
        // The growth is that of the means over whole periods.
        let mut means = Vec::new();
        for _ in 0..12 {
            let (mut logarithm, mut square) = (0.0, 0.0);
            for _ in 0..steps {
                let add = |state: [f64; N], slope: [f64; N], by: f64| {
                    let mut sum = state;
                    sum.iter_mut().zip(slope).for_each(|(x, s)| *x += by * s);
                    sum
                };
                let first = field.slope(state);
                let second = field.slope(add(state, first, 0.5 * step));
                let third = field.slope(add(state, second, 0.5 * step));
                let fourth = field.slope(add(state, third, step));
                for (slope, weight) in [(first, 1.0), (second, 2.0), (third, 2.0), (fourth, 1.0)] {
                    state = add(state, slope, step * weight / 6.0);
                }
                let z = p.dotc(&Vector::from_iterator(
                    N,
                    state.iter().map(|x| Complex::new(*x, 0.0)),
                ));
                logarithm += libm::log(z.norm()) / steps as f64;
                square += z.norm_sqr() / steps as f64;
            }
            means.push([logarithm, square]);
        }
        let (first, last) = (means[1], means[11]);
        [
            (last[0] - first[0]) / (10.0 * period),
            0.5 * (first[1] + last[1]),
        ]
    }

    /// Near a Hopf point an oscillation z of amplitude |z| grows with the rate
    /// Re λ + Re c₁ |z|², and Re c₁ = ω l₁.
    #[test]
    fn simulated_oscillations_grow_with_the_rate_of_the_coefficient() {
        for (law, speed) in [
            (Law::FrontPoint, 0.5),
            (Law::FrontPoint, 3.0),
            (Law::VelocityPoint, 1.0),
            (Law::VelocityPoint, 2.0),
        ] {
            let vehicle = VehicleParameters::paper();
            let points = hopf_points(vehicle, law, Belief::CentreOfMass, 0.35, speed).unwrap();
            let HopfPoint {
                deviation,
                angular_frequency,
                lyapunov,
                ..
            } = points[0];
            let at = ClosedLoop::new(vehicle, law, 0.35, speed, deviation).unwrap();
            let growth = |amplitude| match law {
                Law::FrontPoint => simulated_growth(
                    &FrontPointField(&at),
                    &at.jacobian(),
                    angular_frequency,
                    amplitude,
                ),
                Law::VelocityPoint => simulated_growth(
                    &VelocityPointField(&at),
                    &at.jacobian(),
                    angular_frequency,
                    amplitude,
                ),
            };
            let [rate, square] = growth(0.02);
            let coefficient = rate / square;
            assert!(
                (coefficient / lyapunov.matcont - 1.0).abs() < 0.02,
                "{law:?} {speed}: {coefficient} {lyapunov:?}"
            );
        }
    }
}
