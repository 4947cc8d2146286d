//! Steady circles with tyres that slide.
//!
//! P follows a circle at constant speed under the proposed law, which has the right centre of
//! mass. The tyres saturate. On the circle, yaw rate, sideslip and steering are constant, and
//! yaw turns with the commanded velocity of P. Both axles slide by the same share of their
//! grip, since their moments cancel; over this share the speed of P has a maximum: a fold,
//! where two steady circles meet. The tyres allow no steady circle at a higher speed.
//!
//! Errors of the position of P are not among the states: the law linearises P exactly here too,
//! so that they decay on their own, as the outer loop says.

use libm::{atan2, atanh, cos, fabs, hypot, sin, sqrt, tanh};
use nalgebra::{Complex, Matrix4};
use num_dual::{Dual64, DualNum};
use singletrack_control::{
    Axles, Functions, GRAVITY, LateralMotion, Tyres, VehicleParameterError, VehicleParameters,
};

/// A dual number, or `f64`.
trait Dual: DualNum<Primitive = f64> + Copy {}

impl<D: DualNum<Primitive = f64> + Copy> Dual for D {}

/// The elementary functions of dual numbers.
enum DualFunctions {}

impl<D: Dual> Functions<D> for DualFunctions {
    fn sin_cos(angle: D) -> (D, D) {
        angle.sin_cos()
    }

    fn tanh(x: D) -> D {
        x.tanh()
    }

    fn atan2(y: D, x: D) -> D {
        y.atan2(x)
    }
}

/// A circle of P, and the car that follows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Circle {
    vehicle: VehicleParameters,
    point_distance: f64,
    radius: f64,
}

/// A steady motion of the car on a [`Circle`], to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SteadyCircle {
    circle: Circle,
    /// Speed of P, in m/s.
    pub(crate) point_speed: f64,
    /// Speed of G, in m/s.
    pub(crate) speed: f64,
    /// Yaw rate, in rad/s.
    pub(crate) yaw_rate: f64,
    /// Sideslip, in rad.
    pub(crate) sideslip: f64,
    /// Steering angle, in rad.
    pub(crate) steering: f64,
    /// Yaw less the direction of the velocity of P, in rad.
    pub(crate) yaw_off_velocity: f64,
    /// The share of the grip that both axles use.
    pub(crate) tyre_use: f64,
}

/// A circle that no car can follow.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub(crate) enum CircleError {
    /// The parameters of the vehicle are invalid.
    #[error(transparent)]
    Vehicle(#[from] VehicleParameterError),
    /// The distance p is invalid.
    #[error("the point distance p is {0} m: it must be finite and above zero")]
    PointDistance(f64),
    /// The circle is too small for a car that moves forward.
    #[error("a circle of {radius} m is too small for P: with the wheelbase it needs {least} m")]
    Radius {
        /// The radius, in m.
        radius: f64,
        /// The least radius, in m.
        least: f64,
    },
}

/// The largest slip angle of the search, over the one at which a linear tyre would reach the
/// limit of its grip.
const MOST_SLIP: f64 = 6.0;
const STEPS: usize = 120;

impl Circle {
    /// P of `vehicle` at `point_distance` (p, m) on a circle of `radius` (m).
    ///
    /// # Errors
    ///
    /// Invalid parameters, or a radius below wheelbase and p.
    pub(crate) fn new(
        vehicle: VehicleParameters,
        point_distance: f64,
        radius: f64,
    ) -> Result<Self, CircleError> {
        vehicle.validate()?;
        if !(point_distance.is_finite() && point_distance > 0.0) {
            return Err(CircleError::PointDistance(point_distance));
        }
        let least = vehicle.wheelbase_m() + point_distance;
        if !(radius.is_finite() && radius > least) {
            return Err(CircleError::Radius { radius, least });
        }
        Ok(Self {
            vehicle,
            point_distance,
            radius,
        })
    }

    /// The fastest steady circle, at the fold.
    pub(crate) fn fold(&self) -> SteadyCircle {
        // A coarse maximum, and a golden section around it.
        let at = |step: usize| MOST_SLIP * step as f64 / STEPS as f64;
        let speed = |slip: f64| self.at_slip(slip).point_speed;
        let best = (1..STEPS)
            .max_by(|one, other| speed(at(*one)).total_cmp(&speed(at(*other))))
            .unwrap_or(1);
        let (mut low, mut high) = (at(best - 1), at(best + 1));
        let golden = 0.5 * (sqrt(5.0) - 1.0);
        while high - low > 1e-9 {
            let (one, other) = (high - golden * (high - low), low + golden * (high - low));
            if speed(one) < speed(other) {
                low = one;
            } else {
                high = other;
            }
        }
        self.at_slip(0.5 * (low + high))
    }

    /// The steady circle with P at `point_speed` (m/s), of the two the one with the smaller
    /// slip angles. None beyond the fold.
    pub(crate) fn at_speed(&self, point_speed: f64) -> Option<SteadyCircle> {
        let fold = self.fold();
        if !(point_speed > 0.0 && point_speed < fold.point_speed) {
            return None;
        }
        let (mut low, mut high) = (0.0, atanh(fold.tyre_use));
        while high - low > 1e-15 * high {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if self.at_slip(middle).point_speed < point_speed {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(self.at_slip(0.5 * (low + high)))
    }

    /// The steady circle with these slip angles, over those at which linear tyres would reach
    /// the limit of their grip.
    fn at_slip(&self, slip: f64) -> SteadyCircle {
        let VehicleParameters {
            mass_kg: m,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            friction,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = self.vehicle;
        let p = self.point_distance;
        let wheelbase = l_f + l_r;
        let per_metre = friction * m * GRAVITY / wheelbase;
        let front_slip = slip * per_metre * l_r / c_f;
        let rear_slip = slip * per_metre * l_f / c_r;
        let tyre_use = tanh(slip);
        let geometry = |curvature: f64| {
            let sideslip = l_r * curvature - rear_slip;
            let steering = front_slip - rear_slip + wheelbase * curvature;
            // P from the centre of the circle, in the car's frame.
            let x = l_f + p * cos(steering) + sin(sideslip) / curvature;
            let y = p * sin(steering) - cos(sideslip) / curvature;
            (sideslip, steering, x, y)
        };
        // Over the curvature of G's path, P comes nearer to the centre.
        let (mut low, mut high) = (1e-6 / self.radius, 1.0 / wheelbase);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            let (.., x, y) = geometry(middle);
            if hypot(x, y) > self.radius {
                low = middle;
            } else {
                high = middle;
            }
        }
        let curvature = 0.5 * (low + high);
        let (sideslip, steering, x, y) = geometry(curvature);
        let speed = sqrt(tyre_use * friction * GRAVITY / curvature);
        let yaw_rate = curvature * speed;
        SteadyCircle {
            circle: *self,
            point_speed: yaw_rate * self.radius,
            speed,
            yaw_rate,
            sideslip,
            steering,
            yaw_off_velocity: -atan2(x, -y),
            tyre_use,
        }
    }
}

impl SteadyCircle {
    /// The eigenvalues of yaw, yaw rate, sideslip and steering on this circle, in 1/s, by
    /// ascending real part.
    pub(crate) fn eigenvalues(&self) -> [Complex<f64>; 4] {
        let columns = [0, 1, 2, 3].map(|column: usize| {
            let mut state = self.state().map(Dual64::from);
            state[column].eps = 1.0;
            self.slope(state).map(|slope| slope.eps)
        });
        let jacobian = Matrix4::from_iterator(columns.into_iter().flatten());
        let mut eigenvalues: [Complex<f64>; 4] = jacobian.complex_eigenvalues().into();
        eigenvalues.sort_unstable_by(|a, b| a.re.total_cmp(&b.re).then(a.im.total_cmp(&b.im)));
        eigenvalues
    }

    /// By how much the steady motion fails its own equations: the largest slope, in rad and s.
    pub(crate) fn residual(&self) -> f64 {
        self.slope(self.state())
            .into_iter()
            .fold(0.0, |largest, slope: f64| largest.max(fabs(slope)))
    }

    const fn state(&self) -> [f64; 4] {
        [
            self.yaw_off_velocity,
            self.yaw_rate,
            self.sideslip,
            self.steering,
        ]
    }

    /// Equation 7 and Newton's equations with saturating tyres; yaw is relative to the velocity
    /// of P, which turns.
    fn slope<D: Dual>(&self, [yaw, yaw_rate, sideslip, steering]: [D; 4]) -> [D; 4] {
        let Circle {
            vehicle,
            point_distance: p,
            radius,
        } = self.circle;
        let l_f = vehicle.front_axle_distance_m;
        let cosine = (sideslip - steering).cos();
        let speed =
            ((yaw + steering).cos() * self.point_speed - yaw_rate * steering.sin() * l_f) / cosine;
        let steering_rate = (-(yaw + sideslip).sin() * self.point_speed
            - yaw_rate * sideslip.cos() * l_f)
            / (cosine * p)
            - yaw_rate;
        let motion = LateralMotion {
            yaw_rate,
            sideslip,
            speed,
            steering,
        };
        let axles = Axles::new(vehicle, Tyres::Saturating);
        let forces = axles.forces::<DualFunctions, D>(&motion);
        let lateral = axles.lateral::<DualFunctions, D>(&motion, &forces);
        [
            yaw_rate - self.point_speed / radius,
            lateral.yaw_rate,
            lateral.sideslip,
            steering_rate,
        ]
    }
}
