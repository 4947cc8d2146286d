//! Hopf bifurcations over dl, where the steady motion loses its stability, and the speeds and distances `p`
//! without one.

use nalgebra::Complex;
use singletrack_control::{VehicleParameters, words};

use super::{
    characteristic::{
        CharacteristicPolynomial, front_point_quadratic, front_point_quadratic_in_p, symbols,
    },
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
/// rises wherever it is not negative (see [`OneLength`]), so that only the ends of
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

/// The distances p with which a car is stable under the [`Law::FrontPoint`] for all meaningful dl: at every
/// speed, wherever between the axles the law believes the centre of mass.
///
/// With `x = l_f + dl` from 0 to L, `D = C_f l_f² + C_r l_r²`, `δ = (C_f + C_r)/m + D/I_z` and
/// `κ = C_f C_r L / (m I_z)`, the last but one of Hurwitz' determinants is, up to a positive factor,
///
/// ```text
/// (l_r + x + p) (g + C_f e_f x + C_r e_r p) - I_z δ² p
/// with e_f = (l_f C_f - l_r C_r)/m + l_f D/I_z
///      e_r = (l_r C_r - l_f C_f)/m + l_r D/I_z + δ C_f L²/(m v²)
///      g   = C_f/m (I_z (C_f + C_r)/m + l_f (l_f C_f - l_r C_r))
/// ```
///
/// and the other conditions of Liénard and Chipart hold. With `e_f ≥ 0` the determinant rises with x
/// wherever it is not negative, and `x = 0` decides; else it is concave in x, and both ends decide. At an
/// end it is a quadratic in p. `docs/theorems.md` has the proof, and `lab/certificates/check_one_length.py`
/// checks the identity in exact arithmetic.
#[derive(Clone, Debug, PartialEq)]
pub struct OneLength {
    /// `e_f`, in m²/(s² rad): if it is not negative, the front axle (dl = -`l_f`) decides.
    pub front: f64,
    /// `e_r`, in m²/(s² rad): if it is above zero, every p from some length on will do.
    pub rear: f64,
    /// The ranges of p, in m, ascending; the last one may be without end.
    pub distances: Vec<[f64; 2]>,
}

impl OneLength {
    /// The distances for all speeds up to one in m/s; infinity for all speeds.
    ///
    /// # Errors
    ///
    /// Invalid parameters of the vehicle, or a speed that is not above zero.
    pub fn of(vehicle: VehicleParameters, speed: f64) -> Result<Self, StabilityError> {
        // Checks the parameters; a p and a dl that are valid.
        ClosedLoop::new(vehicle, Law::FrontPoint, 1.0, speed.min(1e6), 0.0)?;
        let [m, inertia, l_f, l_r, c_f, c_r] = symbols(&vehicle);
        let wheelbase = l_f + l_r;
        let turn = l_f * c_f - l_r * c_r;
        let both = c_f * l_f * l_f + c_r * l_r * l_r;
        let damping = (c_f + c_r) / m + both / inertia;
        let front = turn / m + l_f * both / inertia;
        let slow = damping * c_f * wheelbase * wheelbase / (m * speed * speed);
        let rear = -turn / m + l_r * both / inertia + slow;
        let constant = c_f / m * (inertia * (c_f + c_r) / m + l_f * turn);
        let at = |x: f64| {
            let (reach, spring, slope) = (l_r + x, constant + c_f * front * x, c_r * rear);
            not_negative([
                reach * spring,
                spring + reach * slope - inertia * damping * damping,
                slope,
            ])
        };
        let mut distances = at(0.0);
        if front < 0.0 {
            distances = common(&distances, &at(wheelbase));
        }
        Ok(Self {
            front,
            rear,
            distances,
        })
    }
}

/// Where above zero `c₀ + c₁ p + c₂ p²` is not negative.
fn not_negative([c0, c1, c2]: [f64; 3]) -> Vec<[f64; 2]> {
    let at = |p: f64| c0 + p * (c1 + p * c2);
    let mut ends = vec![0.0];
    ends.extend(roots([c0, c1, c2]).filter(|root| *root > 0.0));
    ends.push(f64::INFINITY);
    let mut ranges: Vec<[f64; 2]> = Vec::new();
    for ends in ends.windows(2) {
        let [from, to] = [ends[0], ends[1]];
        let inside = if to.is_finite() {
            0.5 * (from + to)
        } else {
            2.0 * from + 1.0
        };
        if at(inside) < 0.0 {
            continue;
        }
        match ranges.last_mut() {
            // A double root.
            Some(last) if last[1] >= from => last[1] = to,
            _ => ranges.push([from, to]),
        }
    }
    ranges
}

/// What two lists of ranges have in common.
fn common(some: &[[f64; 2]], others: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let pairs = some
        .iter()
        .flat_map(|one| others.iter().map(move |other| (one, other)));
    pairs
        .map(|(one, other)| [one[0].max(other[0]), one[1].min(other[1])])
        .filter(|[from, to]| from < to)
        .collect()
}

/// Squared frequencies per decade of the search for the smallest bound, and its decades around the
/// largest coefficient's.
const PER_DECADE: i32 = 200;
const DECADES: i32 = 6;

impl ClosedLoop {
    /// How long dead time and lag of the steering together may be, in s, for the straight motion to stay
    /// stable: sufficient, by the theorem of small gain. None unless the law is the [`Law::FrontPoint`] and
    /// the motion is stable with wheels that follow at once.
    ///
    /// An actuator `exp(-s τ)/(1 + s T)` differs from one by at most `ω (τ + T)`, so that `τ + T` may be less than
    /// the least `|q(iω)| / |ω n(iω)|`, with the characteristic polynomial `q`, and `n` what the law
    /// contributes to it.
    pub fn actuation_bound(&self) -> Option<f64> {
        let CharacteristicPolynomial::Quartic([a0, a1, a2, a3]) = self.characteristic_polynomial()
        else {
            return None;
        };
        if !self.is_stable() {
            return None;
        }
        let [m, inertia, l_f, _, c_f, _] = symbols(&self.vehicle);
        let (p, x) = (self.point_distance, l_f + self.deviation);
        let n2 = c_f / (m * p) + c_f * l_f * (x + p) / (inertia * p);
        // The square of the bound at the squared frequency y.
        let squared = |y: f64| {
            let (even, odd) = (y * (y - a2) + a0, a1 - a3 * y);
            let own = a0 - n2 * y;
            (even * even + y * odd * odd) / (y * (own * own + y * a1 * a1))
        };
        let middle = libm::sqrt(a0);
        let steps = -DECADES * PER_DECADE..=DECADES * PER_DECADE;
        let at = |step: f64| squared(middle * libm::pow(10.0, step / f64::from(PER_DECADE)));
        let least = steps.min_by(|a, b| at(f64::from(*a)).total_cmp(&at(f64::from(*b))))?;
        // Golden sections around the least of the grid.
        let (mut from, mut to) = (f64::from(least) - 1.0, f64::from(least) + 1.0);
        let golden = 0.5 * (libm::sqrt(5.0) - 1.0);
        for _ in 0..60 {
            let (one, other) = (to - golden * (to - from), from + golden * (to - from));
            if at(one) < at(other) {
                to = other;
            } else {
                from = one;
            }
        }
        Some(libm::sqrt(at(0.5 * (from + to))))
    }
}

/// The real roots of `c₀ + c₁ x + c₂ x²`, ascending, without cancellation.
fn roots([c0, c1, c2]: [f64; 3]) -> impl Iterator<Item = f64> {
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
