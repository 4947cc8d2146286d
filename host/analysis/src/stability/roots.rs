//! The roots of real polynomials of degree three and four, in closed form and polished.
//!
//! A quartic is factored into two real quadratics, a cubic into a linear factor and a
//! quadratic: by the resolvent cubic, and then by Newton's method on the coefficients of the
//! factors, which restores the accuracy that the closed form loses to cancellation. Real
//! arithmetic only, no allocation.

use core::f64::consts::FRAC_PI_3;

use libm::{acos, cbrt, copysign, cos, fabs, sqrt};
use nalgebra::Complex;

/// A monic quadratic factor `s² + b s + c`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Quadratic {
    b: f64,
    c: f64,
}

impl Quadratic {
    /// Both roots, by ascending real part, then imaginary part. Without cancellation.
    fn roots(self) -> [Complex<f64>; 2] {
        let half = -0.5 * self.b;
        let discriminant = half * half - self.c;
        if discriminant < 0.0 {
            let imaginary = sqrt(-discriminant);
            return [
                Complex::new(half, -imaginary),
                Complex::new(half, imaginary),
            ];
        }
        let far = half + copysign(sqrt(discriminant), half);
        let near = if far == 0.0 { 0.0 } else { self.c / far };
        [far.min(near), far.max(near)].map(|real| Complex::new(real, 0.0))
    }
}

/// Newton's steps at most; two or three are needed.
const MOST_STEPS: usize = 12;
/// The step at which the factors are final, relative to their coefficients.
const FINAL_STEP: f64 = 4.0 * f64::EPSILON;
/// A larger relative step at the end is no convergence.
const CONVERGED: f64 = 1e-11;

/// The roots of `s⁴ + a₃ s³ + a₂ s² + a₁ s + a₀`, in no order. None if the factors do not
/// converge, as those with a root in common.
pub(super) fn quartic(a: [f64; 4]) -> Option<[Complex<f64>; 4]> {
    let [one, other] = polished(a, factors(a))?;
    let ([first, second], [third, fourth]) = (one.roots(), other.roots());
    Some([first, second, third, fourth])
}

/// The roots of `s³ + a₂ s² + a₁ s + a₀`, in no order. None if the factors do not converge.
pub(super) fn cubic(a: [f64; 3]) -> Option<[Complex<f64>; 3]> {
    let [a0, a1, a2] = a;
    let shift = a2 / 3.0;
    let depressed = Depressed {
        linear: a1 - a2 * shift,
        constant: a0 - shift * (a1 - 2.0 * shift * shift),
    };
    // Of three real roots the one that is farthest from the other two.
    let mut root = depressed.outer_root() - shift;
    // s³ + a₂ s² + a₁ s + a₀ = (s - root) (s² + b s + c).
    for _ in 0..MOST_STEPS {
        let slope = (3.0 * root + 2.0 * a2) * root + a1;
        let step = (((root + a2) * root + a1) * root + a0) / slope;
        if !step.is_finite() {
            return None;
        }
        root -= step;
        if fabs(step) <= FINAL_STEP * fabs(root) {
            break;
        }
    }
    // The division is accurate from that end of the polynomial where the root is small
    // beside the others.
    let quotient = if fabs(root * root * root) > fabs(a0) {
        let c = -a0 / root;
        Quadratic {
            b: (c - a1) / root,
            c,
        }
    } else {
        let b = a2 + root;
        Quadratic {
            b,
            c: a1 + root * b,
        }
    };
    let [second, third] = quotient.roots();
    let all = [Complex::new(root, 0.0), second, third];
    all.iter()
        .all(|root| root.re.is_finite() && root.im.is_finite())
        .then_some(all)
}

/// `x³ + linear x + constant`.
struct Depressed {
    linear: f64,
    constant: f64,
}

impl Depressed {
    /// Its only real root; of three the one of the largest magnitude.
    fn outer_root(&self) -> f64 {
        let third = self.linear / 3.0;
        let half = self.constant / 2.0;
        let discriminant = half * half + third * third * third;
        if discriminant >= 0.0 {
            let outer = -cbrt(half + copysign(sqrt(discriminant), half));
            if outer == 0.0 {
                0.0
            } else {
                outer - third / outer
            }
        } else {
            let radius = sqrt(-third);
            let cosine = (fabs(half) / (radius * radius * radius)).min(1.0);
            -copysign(2.0 * radius * cos(acos(cosine) / 3.0), half)
        }
    }

    /// The largest real root.
    fn largest_root(&self) -> f64 {
        let third = self.linear / 3.0;
        let half = self.constant / 2.0;
        let discriminant = half * half + third * third * third;
        if discriminant >= 0.0 {
            return self.outer_root();
        }
        let radius = sqrt(-third);
        let cosine = (fabs(half) / (radius * radius * radius)).min(1.0);
        let angle = acos(cosine) / 3.0;
        2.0 * radius
            * if half <= 0.0 {
                cos(angle)
            } else {
                cos(FRAC_PI_3 - angle)
            }
    }
}

/// Approximate quadratic factors of a quartic by Ferrari's resolvent.
fn factors([a0, a1, a2, a3]: [f64; 4]) -> [Quadratic; 2] {
    let quarter = a3 / 4.0;
    let square = quarter * quarter;
    // x = s + a₃/4: x⁴ + p x² + q x + r.
    let p = a2 - 6.0 * square;
    let q = a1 - 2.0 * a2 * quarter + 8.0 * square * quarter;
    let r = a0 - a1 * quarter + a2 * square - 3.0 * square * square;
    // z³ + 2 p z² + (p² - 4 r) z - q²: z is the square of the sum of two roots.
    let shift = 2.0 * p / 3.0;
    let linear = p * p - 4.0 * r;
    let resolvent = Depressed {
        linear: linear - 2.0 * p * shift,
        constant: -q * q - shift * (linear - 2.0 * shift * shift),
    };
    let z = (resolvent.largest_root() - shift).max(0.0);
    let sum = sqrt(z);
    // The two products of roots, from their sum p + z and their difference q/sum; for q = 0
    // the latter follows from the product r.
    let total = p + z;
    let difference = if sum > 0.0 {
        q / sum
    } else {
        sqrt((total * total - 4.0 * r).max(0.0))
    };
    let of = |sum: f64, difference: f64| {
        let product = 0.5 * (total - difference);
        // s = x - a₃/4.
        Quadratic {
            b: sum + 2.0 * quarter,
            c: square + sum * quarter + product,
        }
    };
    let (one, other) = (of(sum, difference), of(-sum, -difference));
    let (far, near) = if fabs(one.c) >= fabs(other.c) {
        (one, other)
    } else {
        (other, one)
    };
    // The factor of the roots near zero has lost digits to the shift: by division.
    let c = a0 / far.c;
    let b = (a1 - far.b * c) / far.c;
    if c.is_finite() && b.is_finite() {
        [far, Quadratic { b, c }]
    } else {
        [far, near]
    }
}

/// Newton's method on the coefficients of the factors.
fn polished(
    [a0, a1, a2, a3]: [f64; 4],
    [mut one, mut other]: [Quadratic; 2],
) -> Option<[Quadratic; 2]> {
    let mut last = f64::INFINITY;
    for _ in 0..MOST_STEPS {
        let Quadratic { b, c } = one;
        let Quadratic { b: d, c: e } = other;
        let r3 = a3 - (b + d);
        let r2 = a2 - (c + e + b * d);
        let r1 = a1 - (b * e + c * d);
        let r0 = a0 - c * e;
        // Of the steps of b and c, with those of d and e eliminated.
        let k = r2 - b * r3;
        let (bb, bc, br) = (e - c - b * (d - b), d - b, r1 - c * r3 - b * k);
        let (cb, cc, cr) = (-c * (d - b), e - c, r0 - c * k);
        let determinant = bb * cc - bc * cb;
        let step_b = (br * cc - bc * cr) / determinant;
        let step_c = (bb * cr - br * cb) / determinant;
        let step_e = (r0 - e * step_c) / c;
        let step_d = (r1 - e * step_b - b * step_e - d * step_c) / c;
        one = Quadratic {
            b: b + step_b,
            c: c + step_c,
        };
        other = Quadratic {
            b: d + step_d,
            c: e + step_e,
        };
        // b may be near zero; sqrt|c| is its scale then.
        let relative = |[step_b, step_c]: [f64; 2], of: Quadratic| {
            let scale = fabs(of.b).max(sqrt(fabs(of.c)));
            (fabs(step_b) / scale).max(fabs(step_c / of.c))
        };
        let size = relative([step_b, step_c], one).max(relative([step_d, step_e], other));
        if !size.is_finite() {
            return None;
        }
        let has_stopped = size <= FINAL_STEP || (size <= CONVERGED && size >= 0.5 * last);
        last = size;
        if has_stopped {
            break;
        }
    }
    (last <= CONVERGED).then_some([one, other])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The backward error: the value of the polynomial at a root over the sum of the
    /// magnitudes of its terms.
    fn residual(coefficients: &[f64], root: Complex<f64>) -> f64 {
        let monic = coefficients.iter().copied().chain([1.0]);
        let (mut value, mut size) = (Complex::new(0.0, 0.0), 0.0);
        for coefficient in monic.rev() {
            value = value * root + coefficient;
            size = size * root.norm() + fabs(coefficient);
        }
        value.norm() / size
    }

    /// The coefficients of `(s² + b s + c) (s² + d s + e)`.
    fn product(b: f64, c: f64, d: f64, e: f64) -> [f64; 4] {
        [c * e, b * e + c * d, c + e + b * d, b + d]
    }

    fn magnitude() -> impl Strategy<Value = f64> {
        (-3.0..3.0, any::<bool>()).prop_map(|(power, minus): (f64, bool)| {
            libm::pow(10.0, power) * if minus { -1.0 } else { 1.0 }
        })
    }

    proptest! {
        #[test]
        fn roots_of_a_quartic_satisfy_it(
            b in magnitude(), c in magnitude(), d in magnitude(), e in magnitude(),
        ) {
            let coefficients = product(b, c, d, e);
            if let Some(roots) = quartic(coefficients) {
                for root in roots {
                    prop_assert!(residual(&coefficients, root) < 1e-12, "{coefficients:?} {roots:?}");
                }
            }
        }

        #[test]
        fn roots_of_a_cubic_satisfy_it(g in magnitude(), b in magnitude(), c in magnitude()) {
            let coefficients = [g * c, c + g * b, g + b];
            let roots = cubic(coefficients).unwrap();
            for root in roots {
                prop_assert!(residual(&coefficients, root) < 1e-12, "{coefficients:?} {roots:?}");
            }
        }
    }

    #[test]
    fn roots_of_all_kinds_are_found() {
        let near = |found: Vec<Complex<f64>>, expected: &[[f64; 2]]| {
            assert_eq!(found.len(), expected.len());
            for [re, im] in expected {
                let expected = Complex::new(*re, *im);
                assert!(
                    found
                        .iter()
                        .any(|found| (found - expected).norm() < 1e-12 * expected.norm()),
                    "{found:?} {expected}"
                );
            }
        };
        // Four reals, a pair and two reals, two pairs, a biquadratic.
        near(
            quartic(product(30.0, 200.0, 3.0, 2.0)).unwrap().to_vec(),
            &[[-20.0, 0.0], [-10.0, 0.0], [-2.0, 0.0], [-1.0, 0.0]],
        );
        near(
            quartic(product(6.0, 34.0, 3.0, 2.0)).unwrap().to_vec(),
            &[[-3.0, -5.0], [-3.0, 5.0], [-2.0, 0.0], [-1.0, 0.0]],
        );
        near(
            quartic(product(0.0, 9.0, 0.0, 4.0)).unwrap().to_vec(),
            &[[0.0, -3.0], [0.0, -2.0], [0.0, 2.0], [0.0, 3.0]],
        );
        near(
            cubic([6.0, 11.0, 6.0]).unwrap().to_vec(),
            &[[-3.0, 0.0], [-2.0, 0.0], [-1.0, 0.0]],
        );
        near(
            cubic([5e-3, 5.002, 2.001]).unwrap().to_vec(),
            &[[-1.0, -2.0], [-1.0, 2.0], [-1e-3, 0.0]],
        );
        // A factor in common: left to another method.
        assert_eq!(quartic([1.0, 4.0, 6.0, 4.0]), None);
    }
}
