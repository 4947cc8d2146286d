//! Hopf bifurcations over dl, where the steady motion loses its stability.

use nalgebra::Complex;
use singletrack_control::{VehicleParameters, words};

use super::{
    characteristic::{CharacteristicPolynomial, front_point_quadratic, front_point_quadratic_in_p},
    closed_loop::{Belief, ClosedLoop, Law, StabilityError},
    lyapunov::Lyapunov,
};

/// A Hopf bifurcation of the steady motion: a pair of eigenvalues crosses the
/// imaginary axis as dl varies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HopfPoint {
    /// The speed of the steady motion, in m/s.
    pub speed: f64,
    /// The deviation dl of the centre of mass, in m.
    pub deviation: f64,
    /// The critical angular frequency: the imaginary part of the pair, in rad/s.
    pub angular_frequency: f64,
    /// The first Lyapunov coefficient.
    pub lyapunov: Lyapunov,
    /// The derivative of the pair's real part by dl, in 1/(s m).
    pub crossing: f64,
    /// The largest real part of the other eigenvalues, in 1/s. If it is negative, stability
    /// ends at this point.
    pub largest_other_real_part: f64,
}

words! {
    /// The kind of limit cycle at a Hopf bifurcation.
    pub enum Criticality {
        /// A stable limit cycle, on the unstable side.
        Supercritical = "supercritical",
        /// An unstable limit cycle, on the stable side: after a large enough disturbance the car
        /// does not return to the stable motion.
        Subcritical = "subcritical",
        /// The first Lyapunov coefficient is zero; higher ones decide.
        Degenerate = "degenerate",
    }
}

impl HopfPoint {
    /// The criticality by the sign of the first Lyapunov coefficient.
    pub fn criticality(&self) -> Criticality {
        if self.lyapunov.kuznetsov > 0.0 {
            Criticality::Subcritical
        } else if self.lyapunov.kuznetsov < 0.0 {
            Criticality::Supercritical
        } else {
            Criticality::Degenerate
        }
    }

    /// Whether the motion is stable on one side of the point.
    pub fn ends_stability(&self) -> bool {
        self.largest_other_real_part < 0.0
    }
}

/// All Hopf points of a car under a law at a speed, by ascending dl: at most two, because
/// Hurwitz' determinant is quadratic in dl. dl may be outside the physically meaningful
/// range.
///
/// `point_distance` is p in m, `speed` in m/s.
///
/// # Errors
///
/// A parameter with which there is no steady motion.
pub fn hopf_points(
    vehicle: VehicleParameters,
    law: Law,
    belief: Belief,
    point_distance: f64,
    speed: f64,
) -> Result<Vec<HopfPoint>, StabilityError> {
    let nominal = ClosedLoop::new(vehicle, law, point_distance, speed, 0.0)?.believing(belief);
    let mut points = Vec::new();
    for deviation in roots(nominal.hurwitz_quadratic()) {
        let closed_loop = nominal.with_deviation(deviation)?;
        points.extend(closed_loop.hopf_point());
    }
    Ok(points)
}

/// The limits of stability of `vehicle` under the [`Law::FrontPoint`] as the speed tends to
/// infinity: the Hopf points of infinite speed, as values of dl (m), ascending.
///
/// # Errors
///
/// Invalid parameters of the vehicle, or an invalid p (m).
pub fn infinite_speed_limit(
    vehicle: VehicleParameters,
    point_distance: f64,
) -> Result<Vec<f64>, StabilityError> {
    // Checks the other parameters; the speed does not matter.
    ClosedLoop::new(vehicle, Law::FrontPoint, point_distance, 1.0, 0.0)?;
    Ok(roots(front_point_quadratic(&vehicle, point_distance, 0.0))
        // At the other points the opposite roots are real.
        .filter(|deviation| vehicle.wheelbase_m() + point_distance + deviation > 0.0)
        .collect())
}

/// The speed in m/s up to which `vehicle` is stable under the [`Law::FrontPoint`] for
/// every dl of `deviations` (m). None if it is stable at every speed, zero if at no speed.
///
/// Hurwitz' determinant over a₁ is affine in 1/v² with a positive slope. Over dl it is concave, or it
/// rises wherever it is not negative (see [`OneLength`](super::OneLength)), so that only the ends of
/// the range need to be examined.
///
/// # Errors
///
/// Invalid parameters of the vehicle, or an invalid p (m) or dl.
pub fn critical_speed(
    vehicle: VehicleParameters,
    point_distance: f64,
    deviations: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    let mut critical: Option<f64> = None;
    for deviation in deviations {
        ClosedLoop::new(vehicle, Law::FrontPoint, point_distance, 1.0, deviation)?;
        let at = |inverse_square| {
            let [c0, c1, c2] = front_point_quadratic(&vehicle, point_distance, inverse_square);
            c0 + deviation * (c1 + deviation * c2)
        };
        let fast = at(0.0);
        let speed = if vehicle.wheelbase_m() + point_distance + deviation <= 0.0 {
            0.0
        } else if fast >= 0.0 {
            continue;
        } else {
            libm::sqrt((at(1.0) - fast) / -fast)
        };
        critical = Some(critical.map_or(speed, |other| other.min(speed)));
    }
    Ok(critical)
}

/// The distance p in m beyond which `vehicle` is stable under the [`Law::FrontPoint`]
/// at every speed, for every dl of `deviations` (m). None if there is no such p.
///
/// p² v² times Hurwitz' determinant at infinite speed is quadratic in p. As in
/// [`critical_speed`], only the ends of the range need to be examined. (Below the smaller
/// root, a few mm, the car is stable too.)
///
/// # Errors
///
/// Invalid parameters of the vehicle, or an invalid dl.
pub fn smallest_point_distance(
    vehicle: VehicleParameters,
    deviations: [f64; 2],
) -> Result<Option<f64>, StabilityError> {
    let mut smallest: f64 = 0.0;
    for deviation in deviations {
        // Checks the other parameters; p and the speed do not matter.
        ClosedLoop::new(vehicle, Law::FrontPoint, 1.0, 1.0, deviation)?;
        let quadratic = front_point_quadratic_in_p(&vehicle, deviation);
        if quadratic[2] <= 0.0 {
            return Ok(None);
        }
        let beyond_wheelbase = -(vehicle.wheelbase_m() + deviation);
        smallest = roots(quadratic).fold(smallest.max(beyond_wheelbase), f64::max);
    }
    Ok(Some(smallest))
}

impl ClosedLoop {
    /// The Hopf point at this loop's dl, where Hurwitz' determinant must be zero.
    fn hopf_point(&self) -> Option<HopfPoint> {
        let polynomial = self.characteristic_polynomial();
        let squared = polynomial.squared_frequency();
        if squared <= 0.0 {
            return None;
        }
        let frequency = libm::sqrt(squared);
        Some(HopfPoint {
            speed: self.speed,
            deviation: self.deviation,
            angular_frequency: frequency,
            lyapunov: Lyapunov::of(self, frequency)?,
            crossing: self.crossing(frequency)?,
            largest_other_real_part: largest_other(&polynomial, squared),
        })
    }

    /// The derivative by dl of the real part of the eigenvalue i ω.
    fn crossing(&self, frequency: f64) -> Option<f64> {
        let at_zero = self.with_deviation(0.0).ok()?.characteristic_polynomial();
        let at_one = self.with_deviation(1.0).ok()?.characteristic_polynomial();
        let slopes = at_zero.coefficients().iter().zip(at_one.coefficients());
        let eigenvalue = Complex::new(0.0, frequency);
        let mut by_deviation = Complex::new(0.0, 0.0);
        let mut by_eigenvalue = Complex::new(0.0, 0.0);
        let mut power = Complex::new(1.0, 0.0);
        let own = self.characteristic_polynomial();
        for (index, (zero, one)) in slopes.enumerate() {
            by_deviation += power * (one - zero);
            let next = own.coefficients().get(index + 1).copied().unwrap_or(1.0);
            by_eigenvalue += power * next * (index + 1) as f64;
            power *= eigenvalue;
        }
        Some(-(by_deviation / by_eigenvalue).re)
    }
}

/// The largest real part of the other roots beside an imaginary pair with the squared
/// frequency `squared`: those of the quotient by `s² + ω²`.
fn largest_other(polynomial: &CharacteristicPolynomial, squared: f64) -> f64 {
    match *polynomial {
        CharacteristicPolynomial::Quartic([a0, _, _, a3]) => {
            let product = a0 / squared;
            let discriminant = 0.25 * a3 * a3 - product;
            if discriminant <= 0.0 {
                -0.5 * a3
            } else if a3 > 0.0 {
                // In this form without cancellation near zero.
                -product / (0.5 * a3 + libm::sqrt(discriminant))
            } else {
                -0.5 * a3 + libm::sqrt(discriminant)
            }
        }
        CharacteristicPolynomial::Cubic([_, _, a2]) => -a2,
    }
}

/// The real roots of `c₀ + c₁ x + c₂ x²`, ascending, without cancellation.
pub(super) fn roots([c0, c1, c2]: [f64; 3]) -> impl Iterator<Item = f64> {
    // Not a number, and neither are the roots, where they are not real.
    let distance = libm::sqrt(c1 * c1 - 4.0 * c2 * c0);
    let q = -0.5 * (c1 + libm::copysign(distance, c1));
    let mut roots = [c0 / q, q / c2];
    roots.sort_by(f64::total_cmp);
    roots.into_iter().filter(|root| root.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_of_a_quadratic_have_no_cancellation() {
        let of = |c| roots(c).collect::<Vec<_>>();
        assert_eq!(of([6.0, -5.0, 1.0]), [2.0, 3.0]);
        assert_eq!(of([1.0, 0.0, 1.0]), [] as [f64; 0]);
        // A linear and a constant polynomial.
        assert_eq!(of([-3.0, 2.0, 0.0]), [1.5]);
        assert_eq!(of([1.0, 0.0, 0.0]), [] as [f64; 0]);
        let [small, large] = of([1e-9, -1.0, 1.0])[..] else {
            panic!("two roots");
        };
        assert!((small / 1e-9 - 1.0).abs() < 2e-9 && (large - 1.0).abs() < 2e-9);
    }
}
