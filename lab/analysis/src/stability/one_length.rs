//! When the distance `p` alone makes a car stable: at every speed, wherever between the axles the law
//! believes the centre of mass.
//!
//! With `x = l_f + dl` from 0 to L, `D = C_f l_f² + C_r l_r²`, `δ = (C_f + C_r)/m + D/I_z` and
//! `κ = C_f C_r L / (m I_z)`, the last but one of Hurwitz' determinants is, up to a positive factor,
//!
//! ```text
//! (l_r + x + p) (g + C_f e_f x + C_r e_r p) - I_z δ² p
//! with e_f = (l_f C_f - l_r C_r)/m + l_f D/I_z
//!      e_r = (l_r C_r - l_f C_f)/m + l_r D/I_z + δ C_f L²/(m v²)
//!      g   = C_f/m (I_z (C_f + C_r)/m + l_f (l_f C_f - l_r C_r))
//! ```
//!
//! and the other conditions of Liénard and Chipart hold. With `e_f ≥ 0` the determinant rises with x
//! wherever it is not negative, and `x = 0` decides; else it is concave in x, and both ends decide. At an
//! end it is a quadratic in p. `docs/theorems.md` has the proof, and `lab/certificates/check_one_length.py`
//! checks the identity in exact arithmetic.

use singletrack_control::VehicleParameters;

use super::{
    characteristic::{CharacteristicPolynomial, symbols},
    closed_loop::{ClosedLoop, Law, StabilityError},
};

/// The distances p with which a car is stable under the [`Law::FrontPoint`] for all meaningful dl.
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
    ends.extend(super::hopf::roots([c0, c1, c2]).filter(|root| *root > 0.0));
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
