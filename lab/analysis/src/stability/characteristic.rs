//! The characteristic polynomial of the steady motion, in closed form.
//!
//! With `L = l_f + l_r`, `M = C_r l_r - C_f l_f`, `S = C_f + C_r` and
//! `D = C_f l_f² + C_r l_r²`, the proposed law (equation 8) gives
//!
//! ```text
//! a₃ = (S/m + D/I_z) / v
//! a₂ = C_f/(m p) + M/I_z + C_f l_f (l_f + dl + p)/(I_z p) + κ L/v²
//! a₁ = κ (L + p + dl) / (p v)
//! a₀ = κ / p                                  with κ = C_f C_r L / (m I_z)
//! ```
//!
//! and the law of the appendix
//!
//! ```text
//! a₂ = R + v/p
//! a₁ = R v/p + Q + E (n - Q)
//! a₀ = Q v/p
//! with Q = C_r L/I_z,  n = l_f m v²/(I_z p),  E = w dl/(m v²),
//!      R = (C_r l_r L - w l_f dl)/(I_z v)
//! ```
//!
//! where w is S if the centre of mass is wrong, and `C_f` if only the front axle is wrong.
//! All coefficients are affine in dl, so that Hurwitz' determinant is quadratic in dl. Under
//! the proposed law a₀ is positive for every car: only a Hopf bifurcation can end stability.
//! Hurwitz' determinant contains v in one positive term only, `κ L/v²`: a car that is stable
//! at some speed is stable at all lower speeds.

use nalgebra::Complex;
use singletrack_control::VehicleParameters;

use super::closed_loop::{Belief, ClosedLoop, Law};

/// The monic characteristic polynomial of a [`ClosedLoop`], without its leading coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CharacteristicPolynomial {
    /// `s⁴ + a₃ s³ + a₂ s² + a₁ s + a₀`: [a₀, a₁, a₂, a₃].
    Quartic([f64; 4]),
    /// `s³ + a₂ s² + a₁ s + a₀`: [a₀, a₁, a₂].
    Cubic([f64; 3]),
}

impl CharacteristicPolynomial {
    /// The coefficients from a₀ on.
    pub const fn coefficients(&self) -> &[f64] {
        match self {
            Self::Quartic(a) => a,
            Self::Cubic(a) => a,
        }
    }

    /// Whether all roots have negative real parts (Liénard and Chipart).
    pub fn is_stable(&self) -> bool {
        self.coefficients().iter().all(|a| *a > 0.0) && self.hurwitz_determinant() > 0.0
    }

    /// Whether all coefficients are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.coefficients().iter().all(|a| a.is_finite())
    }

    /// The root near `root`, by Newton's method for as long as it comes nearer.
    pub(super) fn polished(&self, mut root: Complex<f64>) -> Complex<f64> {
        let at = |root: Complex<f64>| {
            let (mut value, mut slope) = (Complex::new(1.0, 0.0), Complex::new(0.0, 0.0));
            for coefficient in self.coefficients().iter().rev() {
                slope = slope * root + value;
                value = value * root + coefficient;
            }
            (value, slope)
        };
        let (mut value, mut slope) = at(root);
        loop {
            let next = root - value / slope;
            let (next_value, next_slope) = at(next);
            // Also ends where the slope is zero.
            let is_nearer = next_value.norm() < value.norm();
            if !is_nearer {
                return root;
            }
            (root, value, slope) = (next, next_value, next_slope);
        }
    }

    /// The last but one of Hurwitz' determinants: zero where two roots are opposite, as those
    /// of an imaginary pair are.
    pub fn hurwitz_determinant(&self) -> f64 {
        match *self {
            Self::Quartic([a0, a1, a2, a3]) => a1 * (a3 * a2 - a1) - a3 * a3 * a0,
            Self::Cubic([a0, a1, a2]) => a2 * a1 - a0,
        }
    }

    /// Where Hurwitz' determinant is zero, the squared frequency of the pair of imaginary roots;
    /// negative if the opposite roots are real.
    pub fn squared_frequency(&self) -> f64 {
        match *self {
            Self::Quartic([_, a1, _, a3]) => a1 / a3,
            Self::Cubic([_, a1, _]) => a1,
        }
    }
}

/// A value that depends on dl as `constant + slope dl`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine {
    pub(super) constant: f64,
    pub(super) slope: f64,
}

impl Affine {
    const fn new(constant: f64, slope: f64) -> Self {
        Self { constant, slope }
    }

    fn at(self, deviation: f64) -> f64 {
        self.constant + self.slope * deviation
    }

    /// The coefficients of the product of two, by power of dl.
    fn times(self, other: Self) -> [f64; 3] {
        [
            self.constant * other.constant,
            self.constant * other.slope + self.slope * other.constant,
            self.slope * other.slope,
        ]
    }
}

impl ClosedLoop {
    /// The characteristic polynomial of the steady motion.
    pub fn characteristic_polynomial(&self) -> CharacteristicPolynomial {
        match self.law {
            Law::FrontPoint => {
                let [a0, a1, a2, a3] =
                    front_point(&self.vehicle, self.point_distance, self.inverse_square());
                let v = self.speed;
                let dl = self.deviation;
                CharacteristicPolynomial::Quartic([
                    a0.at(dl),
                    a1.at(dl) / v,
                    a2.at(dl),
                    a3.at(dl) / v,
                ])
            }
            Law::VelocityPoint => CharacteristicPolynomial::Cubic(
                self.velocity_point_coefficients()
                    .map(|a| a.at(self.deviation)),
            ),
        }
    }

    /// Whether the steady motion is asymptotically stable, by Hurwitz' criterion.
    pub fn is_stable(&self) -> bool {
        self.characteristic_polynomial().is_stable()
    }

    fn inverse_square(&self) -> f64 {
        1.0 / (self.speed * self.speed)
    }

    /// Hurwitz' determinant as a quadratic in dl, by power, up to a positive factor.
    pub(super) fn hurwitz_quadratic(&self) -> [f64; 3] {
        match self.law {
            Law::FrontPoint => {
                front_point_quadratic(&self.vehicle, self.point_distance, self.inverse_square())
            }
            Law::VelocityPoint => {
                let [a0, a1, a2] = self.velocity_point_coefficients();
                let [c0, c1, c2] = a2.times(a1);
                [c0 - a0.constant, c1 - a0.slope, c2]
            }
        }
    }

    fn velocity_point_coefficients(&self) -> [Affine; 3] {
        let [m, i_z, l_f, l_r, c_f, c_r] = symbols(&self.vehicle);
        let (v, p) = (self.speed, self.point_distance);
        let wheelbase = l_f + l_r;
        let w = match self.belief {
            Belief::CentreOfMass => c_f + c_r,
            Belief::FrontAxle => c_f,
        };
        let q = c_r * wheelbase / i_z;
        let n = l_f * m * v * v / (i_z * p);
        let r = Affine::new(c_r * l_r * wheelbase / (i_z * v), -w * l_f / (i_z * v));
        let e = w / (m * v * v);
        [
            Affine::new(q * v / p, 0.0),
            Affine::new(r.constant * v / p + q, r.slope * v / p + e * (n - q)),
            Affine::new(r.constant + v / p, r.slope),
        ]
    }
}

/// `m`, `I_z`, `l_f`, `l_r`, `C_f` and `C_r` of the equations.
pub(super) const fn symbols(vehicle: &VehicleParameters) -> [f64; 6] {
    [
        vehicle.mass_kg,
        vehicle.yaw_inertia_kg_m2,
        vehicle.front_axle_distance_m,
        vehicle.rear_axle_distance_m,
        vehicle.front_cornering_stiffness_n_rad,
        vehicle.rear_cornering_stiffness_n_rad,
    ]
}

/// a₀, v a₁, a₂ and v a₃ of the front-point law at 1/v².
fn front_point(vehicle: &VehicleParameters, p: f64, inverse_square: f64) -> [Affine; 4] {
    let [m, i_z, l_f, l_r, c_f, c_r] = symbols(vehicle);
    let wheelbase = l_f + l_r;
    let kappa = c_f * c_r * wheelbase / (m * i_z);
    let front = c_f * l_f / (i_z * p);
    [
        Affine::new(kappa / p, 0.0),
        Affine::new(kappa * (wheelbase + p) / p, kappa / p),
        Affine::new(
            c_f / (m * p)
                + (c_r * l_r - c_f * l_f) / i_z
                + front * (l_f + p)
                + kappa * wheelbase * inverse_square,
            front,
        ),
        Affine::new(
            (c_f + c_r) / m + (c_f * l_f * l_f + c_r * l_r * l_r) / i_z,
            0.0,
        ),
    ]
}

/// v² times Hurwitz' determinant of the front-point law at 1/v², as a quadratic in dl, by
/// power. 1/v² may be zero.
pub(super) fn front_point_quadratic(
    vehicle: &VehicleParameters,
    p: f64,
    inverse_square: f64,
) -> [f64; 3] {
    let [a0, a1, a2, a3] = front_point(vehicle, p, inverse_square);
    let a3 = a3.constant;
    let other = Affine::new(a3 * a2.constant - a1.constant, a3 * a2.slope - a1.slope);
    let [c0, c1, c2] = a1.times(other);
    [c0 - a3 * a3 * a0.constant, c1, c2]
}

/// p² v² times Hurwitz' determinant of the front-point law at infinite speed over κ, as
/// a quadratic in p, by power.
pub(super) fn front_point_quadratic_in_p(vehicle: &VehicleParameters, deviation: f64) -> [f64; 3] {
    let [m, i_z, l_f, l_r, c_f, c_r] = symbols(vehicle);
    let wheelbase = l_f + l_r;
    let kappa = c_f * c_r * wheelbase / (m * i_z);
    let damping = (c_f + c_r) / m + (c_f * l_f * l_f + c_r * l_r * l_r) / i_z;
    // v a₁ p/κ = L + dl + p, and p a₂ = c_f/m + c_f l_f (l_f + dl)/I_z + C_r l_r p/I_z.
    let reach = Affine::new(wheelbase + deviation, 1.0);
    let spring = Affine::new(
        c_f / m + c_f * l_f * (l_f + deviation) / i_z,
        c_r * l_r / i_z,
    );
    let [c0, c1, c2] = reach.times(Affine::new(
        damping * spring.constant - kappa * reach.constant,
        damping * spring.slope - kappa * reach.slope,
    ));
    [c0, c1 - damping * damping, c2]
}
