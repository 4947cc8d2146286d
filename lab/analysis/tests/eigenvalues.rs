//! The eigenvalues, against those of the Jacobian by the QR algorithm alone, and against the
//! characteristic polynomial in closed form.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use nalgebra::Complex;
use singletrack_analysis::stability::{ClosedLoop, Law};
use singletrack_control::VehicleParameters;

/// 80 speeds by 121 deviations: the map of the benchmark.
fn map(law: Law) -> impl Iterator<Item = ClosedLoop> {
    (1..=80).flat_map(move |speed| {
        (-60..=60).map(move |deviation| {
            ClosedLoop::new(
                VehicleParameters::paper(),
                law,
                0.35,
                f64::from(speed) * 0.1,
                f64::from(deviation) * 0.01,
            )
            .unwrap()
        })
    })
}

/// The eigenvalues of the Jacobian by the QR algorithm, in the order of ours.
fn by_qr(closed_loop: &ClosedLoop) -> Vec<Complex<f64>> {
    let mut eigenvalues = closed_loop
        .jacobian()
        .complex_eigenvalues()
        .as_slice()
        .to_vec();
    eigenvalues.sort_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
    eigenvalues
}

/// Two computations in double precision differ by the roundings of the worse one: those of the
/// QR algorithm, relative to the largest entry of the Jacobian, and magnified where two
/// eigenvalues nearly coincide, by the size of the Jacobian over their distance.
#[test]
fn they_equal_those_of_a_general_solver() {
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        let mut worst: f64 = 0.0;
        for at in map(law) {
            let scale = at.jacobian().norm();
            let ours = at.eigenvalues();
            for (one, other) in ours.iter().zip(by_qr(&at)) {
                let nearest = ours
                    .iter()
                    .map(|value| (value - one).norm())
                    .filter(|distance| *distance > 0.0)
                    .fold(scale, f64::min);
                let deviation = (one - other).norm() / scale * (nearest / scale).min(1.0);
                worst = worst.max(deviation);
                assert!(deviation < 1e-12, "{at:?}: {one} {other}");
            }
        }
        println!("{law:?}: worst {worst:e}");
    }
}

/// The value of the closed-form polynomial at each eigenvalue over the sum of its terms: no
/// solver could be better than a few roundings.
#[test]
fn they_are_roots_of_the_characteristic_polynomial_to_the_last_digits() {
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        let mut worst: f64 = 0.0;
        for at in map(law) {
            let polynomial = at.characteristic_polynomial();
            for root in &at.eigenvalues() {
                let (mut value, mut size) = (Complex::new(1.0, 0.0), 1.0);
                for coefficient in polynomial.coefficients().iter().rev() {
                    value = value * root + coefficient;
                    size = size * root.norm() + coefficient.abs();
                }
                worst = worst.max(value.norm() / size);
            }
        }
        println!("{law:?}: worst {worst:e}");
        assert!(worst < 4.0 * f64::EPSILON, "{law:?}: {worst:e}");
    }
}
