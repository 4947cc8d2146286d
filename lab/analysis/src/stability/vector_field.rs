//! The vector field of the closed loop, for numbers that carry their derivatives, and its Jacobian and
//! eigenvalues at the steady motion.

use nalgebra::{Complex, DMatrix, Schur};
use num_dual::Dual64;
use singletrack_control::{Axles, Functions, LateralMotion, LateralRate, Number};

use super::{
    characteristic::symbols,
    closed_loop::{Belief, ClosedLoop, Law},
    sampled::Servo,
};
use crate::dual::{Dual, DualFunctions};

/// An autonomous system of N states.
pub(super) trait VectorField<const N: usize> {
    fn closed_loop(&self) -> &ClosedLoop;

    /// The time derivative of the state, with another dl; not numbers where P does not determine
    /// a car that moves forward. A steering angle among the states may leave its limit.
    fn slope_at<D: Dual>(&self, state: &[D; N], deviation: D) -> [D; N];

    /// The steering angle, in rad.
    fn steering<D: Dual>(&self, state: &[D; N], deviation: D) -> D;

    /// The time derivative of the state.
    fn slope<D: Dual>(&self, state: [D; N]) -> [D; N] {
        self.slope_at(&state, D::from(self.closed_loop().deviation))
    }
}

/// Yaw, yaw rate, sideslip and steering under the front-point law.
pub(super) struct FrontPointField<'a>(pub(super) &'a ClosedLoop);

/// Yaw, yaw rate and sideslip under the velocity-point law.
pub(super) struct VelocityPointField<'a>(pub(super) &'a ClosedLoop);

/// Yaw, yaw rate, sideslip, the angle of the wheels, the state of the dead time and the steering
/// angle under the front-point law with a steering servo. The law integrates its own command, and
/// does not know the angle of the wheels.
///
/// The dead time d is Padé's `(1 - s d/2)/(1 + s d/2)`, whose phase errs by (ω d)³/12.
pub(super) struct ServoField<'a>(pub(super) &'a ClosedLoop, pub(super) Servo);

impl VectorField<4> for FrontPointField<'_> {
    fn closed_loop(&self) -> &ClosedLoop {
        self.0
    }

    fn slope_at<D: Dual>(&self, state: &[D; 4], deviation: D) -> [D; 4] {
        self.0
            .front_point_slope::<DualFunctions, D>(state, deviation)
    }

    fn steering<D: Dual>(&self, state: &[D; 4], _: D) -> D {
        state[3]
    }
}

impl VectorField<6> for ServoField<'_> {
    fn closed_loop(&self) -> &ClosedLoop {
        self.0
    }

    fn slope_at<D: Dual>(
        &self,
        &[yaw, yaw_rate, sideslip, wheels, delayed, steering]: &[D; 6],
        deviation: D,
    ) -> [D; 6] {
        let mut motion = LateralMotion {
            yaw_rate,
            sideslip,
            speed: D::from(0.0),
            steering,
        };
        let steering_rate = self
            .0
            .front_point_law::<DualFunctions, D>(yaw, &mut motion, deviation);
        let lateral = self.0.lateral::<DualFunctions, D>(&LateralMotion {
            steering: wheels,
            ..motion
        });
        let Servo { lag, dead_time } = self.1;
        [
            yaw_rate,
            lateral.yaw_rate,
            lateral.sideslip,
            (delayed * 2.0 - steering - wheels) / lag,
            (steering - delayed) * (2.0 / dead_time),
            steering_rate,
        ]
    }

    fn steering<D: Dual>(&self, state: &[D; 6], _: D) -> D {
        state[5]
    }
}

impl VectorField<3> for VelocityPointField<'_> {
    fn closed_loop(&self) -> &ClosedLoop {
        self.0
    }

    fn slope_at<D: Dual>(&self, state: &[D; 3], deviation: D) -> [D; 3] {
        let [yaw, yaw_rate, sideslip] = *state;
        let lateral = self.0.lateral::<DualFunctions, D>(&LateralMotion {
            yaw_rate,
            sideslip,
            speed: positive((yaw + sideslip).cos() * self.0.speed),
            steering: self.steering(state, deviation),
        });
        [yaw_rate, lateral.yaw_rate, lateral.sideslip]
    }

    fn steering<D: Dual>(&self, &[yaw, yaw_rate, sideslip]: &[D; 3], deviation: D) -> D {
        let (p, speed) = (self.0.point_distance, self.0.speed);
        let [m, _, l_f, l_r, c_f, c_r] = symbols(&self.0.vehicle);
        let l_f = deviation + l_f;
        let l_r = match self.0.belief {
            Belief::CentreOfMass => -deviation + l_r,
            Belief::FrontAxle => D::from(l_r),
        };
        // The law of the appendix, with v_P = (speed, 0).
        let course = yaw + sideslip;
        let v = course.cos() * speed;
        let turn_rate = -course.sin() * speed / p;
        let steering = turn_rate * v * (m / c_f) - yaw_rate / v * ((l_r * c_r - l_f * c_f) / c_f)
            + sideslip * ((c_r + c_f) / c_f);
        clamped(steering, self.0.saturation.max_steering)
    }
}

/// The limit of a number, which may have derivatives.
pub(super) trait Clamp<N>: Functions<N> {
    /// `x` within ±`most`.
    fn clamped(x: N, most: f64) -> N;
}

impl<D: Dual> Clamp<D> for DualFunctions {
    fn clamped(x: D, most: f64) -> D {
        clamped(x, most)
    }
}

impl ClosedLoop {
    /// The time derivative of yaw, yaw rate, sideslip and steering under the front-point law.
    pub(super) fn front_point_slope<F: Clamp<D>, D: Number>(
        &self,
        &[yaw, yaw_rate, sideslip, steering]: &[D; 4],
        deviation: D,
    ) -> [D; 4] {
        let mut motion = LateralMotion {
            yaw_rate,
            sideslip,
            speed: D::from(0.0),
            steering,
        };
        let steering_rate = self.front_point_law::<F, D>(yaw, &mut motion, deviation);
        let lateral = self.lateral::<F, D>(&motion);
        [yaw_rate, lateral.yaw_rate, lateral.sideslip, steering_rate]
    }

    /// Equation 8, with `v_P` = (speed, 0): sets the speed of the motion, and gives the steering
    /// rate.
    fn front_point_law<F: Clamp<D>, D: Number>(
        &self,
        yaw: D,
        motion: &mut LateralMotion<D>,
        deviation: D,
    ) -> D {
        let LateralMotion {
            yaw_rate,
            sideslip,
            steering,
            ..
        } = *motion;
        let assumed = deviation + D::from(self.vehicle.front_axle_distance_m);
        let cosine = positive(F::sin_cos(sideslip - steering).1);
        let (sine_of_steering, _) = F::sin_cos(steering);
        let along =
            F::sin_cos(yaw + steering).1 * self.speed - yaw_rate * sine_of_steering * assumed;
        motion.speed = positive(along / cosine);
        let (_, cosine_of_sideslip) = F::sin_cos(sideslip);
        let across =
            -F::sin_cos(yaw + sideslip).0 * self.speed - yaw_rate * cosine_of_sideslip * assumed;
        let rate = across / (cosine * self.point_distance) - yaw_rate;
        F::clamped(rate, self.saturation.max_steering_rate)
    }

    /// The car with its tyres.
    fn lateral<F: Functions<D>, D: Number>(&self, motion: &LateralMotion<D>) -> LateralRate<D> {
        let axles = Axles::new(self.vehicle, self.saturation.tyres)
            .with_slip_angles(self.saturation.slip_angles);
        let forces = axles.forces::<F, D>(motion);
        axles.lateral::<F, D>(motion, &forces)
    }
}

/// `x` if it is above zero, else not a number.
fn positive<D: Number>(x: D) -> D {
    if x > D::from(0.0) {
        x
    } else {
        D::from(f64::NAN)
    }
}

/// `x` within ±`most`.
fn clamped<D: Dual>(x: D, most: f64) -> D {
    if x.re().abs() <= most {
        x
    } else {
        D::from(most.copysign(x.re()))
    }
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;
    use singletrack_control::{
        FrontPointLaw, Motion, SingleTrack, SingleTrackState, VehicleParameters, VelocityPointLaw,
    };

    use super::{super::closed_loop::Law, *};

    fn closed_loop(law: Law, speed: f64, deviation: f64) -> ClosedLoop {
        ClosedLoop::new(VehicleParameters::paper(), law, 0.35, speed, deviation).unwrap()
    }

    fn state(heading: f64, [yaw, yaw_rate, sideslip]: [f64; 3]) -> (Motion, SingleTrackState) {
        let yaw = heading + yaw;
        (
            Motion {
                yaw,
                yaw_rate,
                sideslip,
            },
            SingleTrackState {
                x: 0.0,
                y: 0.0,
                yaw,
                yaw_rate,
                sideslip,
            },
        )
    }

    fn assert_same(ours: &[f64], theirs: &[f64]) {
        for (ours, theirs) in ours.iter().zip(theirs) {
            assert!(
                (ours - theirs).abs() <= 1e-11 * (1.0 + theirs.abs()),
                "{ours} {theirs}"
            );
        }
    }

    proptest! {
        /// The laws are written here for a velocity along x; `singletrack_control` has them
        /// for every direction.
        #[test]
        fn the_vector_field_equals_the_laws_and_the_model_of_the_car(
            speed in 0.1..8.0,
            deviation in -0.13..0.12,
            heading in -3.0..3.0,
            yaw in -0.5..0.5,
            yaw_rate in -2.0..2.0,
            sideslip in -0.3..0.3,
            steering in -0.4..0.4,
        ) {
            let vehicle = VehicleParameters::paper();
            let (motion, car) = state(heading, [yaw, yaw_rate, sideslip]);
            let wanted = speed * Vector2::new(libm::cos(heading), libm::sin(heading));
            let model = SingleTrack::new(vehicle);

            let law = FrontPointLaw::new(
                vehicle.front_axle_distance_m + deviation, 0.35, vehicle.wheelbase_m(),
            ).unwrap();
            let command = law.command(&motion, steering, &wanted).unwrap();
            let slope = model.derivative(&car, command.speed, steering);
            let field = closed_loop(Law::FrontPoint, speed, deviation);
            let ours = FrontPointField(&field).slope([yaw, yaw_rate, sideslip, steering]);
            if command.speed > 0.0 {
                assert_same(
                    &ours,
                    &[slope.yaw, slope.yaw_rate, slope.sideslip, command.steering_rate],
                );
            } else {
                // A slow car that turns fast, with its wheels turned far: P wants it backward.
                assert!(ours[1].is_nan() && ours[2].is_nan(), "{ours:?}");
            }

            let law = VelocityPointLaw::new(
                vehicle.with_centre_of_mass_at(vehicle.front_axle_distance_m + deviation), 0.35,
            ).unwrap();
            let command = law.command(&motion, &wanted).unwrap();
            let slope = model.derivative(&car, command.speed, command.steering);
            let field = closed_loop(Law::VelocityPoint, speed, deviation);
            assert_same(
                &VelocityPointField(&field).slope([yaw, yaw_rate, sideslip]),
                &[slope.yaw, slope.yaw_rate, slope.sideslip],
            );
        }
    }
}
