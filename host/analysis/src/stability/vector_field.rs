//! The vector field of the closed loop, for numbers that carry their derivatives.

use singletrack_control::{LateralMotion, SingleTrack, VehicleParameters};

use super::closed_loop::{Belief, ClosedLoop};
use crate::dual::Dual;

/// An autonomous system of N states.
pub(super) trait VectorField<const N: usize> {
    /// The time derivative of the state.
    fn slope<D: Dual>(&self, state: [D; N]) -> [D; N];
}

/// Yaw, yaw rate, sideslip and steering under the front-point law.
pub(super) struct FrontPointField<'a>(pub(super) &'a ClosedLoop);

/// Yaw, yaw rate and sideslip under the velocity-point law.
pub(super) struct VelocityPointField<'a>(pub(super) &'a ClosedLoop);

impl VectorField<4> for FrontPointField<'_> {
    fn slope<D: Dual>(&self, [yaw, yaw_rate, sideslip, steering]: [D; 4]) -> [D; 4] {
        let ClosedLoop {
            vehicle,
            point_distance: p,
            speed,
            deviation,
            ..
        } = *self.0;
        let assumed = vehicle.front_axle_distance_m + deviation;
        // Equation 8, with v_P = (speed, 0).
        let cosine = (sideslip - steering).cos();
        let v = ((yaw + steering).cos() * speed - yaw_rate * steering.sin() * assumed) / cosine;
        let steering_rate = (-(yaw + sideslip).sin() * speed - yaw_rate * sideslip.cos() * assumed)
            / (cosine * p)
            - yaw_rate;
        let lateral = SingleTrack::new(vehicle).lateral(&LateralMotion {
            yaw_rate,
            sideslip,
            speed: v,
            steering,
        });
        [yaw_rate, lateral.yaw_rate, lateral.sideslip, steering_rate]
    }
}

impl VectorField<3> for VelocityPointField<'_> {
    fn slope<D: Dual>(&self, [yaw, yaw_rate, sideslip]: [D; 3]) -> [D; 3] {
        let ClosedLoop {
            vehicle,
            belief,
            point_distance: p,
            speed,
            deviation,
            ..
        } = *self.0;
        let VehicleParameters {
            mass_kg: m,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = vehicle;
        let l_f = vehicle.front_axle_distance_m + deviation;
        let l_r = match belief {
            Belief::CentreOfMass => vehicle.rear_axle_distance_m - deviation,
            Belief::FrontAxle => vehicle.rear_axle_distance_m,
        };
        // The law of the appendix, with v_P = (speed, 0).
        let course = yaw + sideslip;
        let v = course.cos() * speed;
        let turn_rate = -course.sin() * speed / p;
        let steering = turn_rate * v * (m / c_f) - yaw_rate / v * ((c_r * l_r - c_f * l_f) / c_f)
            + sideslip * ((c_r + c_f) / c_f);
        let lateral = SingleTrack::new(vehicle).lateral(&LateralMotion {
            yaw_rate,
            sideslip,
            speed: v,
            steering,
        });
        [yaw_rate, lateral.yaw_rate, lateral.sideslip]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use proptest::prelude::*;
    use singletrack_control::{FrontPointLaw, Motion, SingleTrackState, VelocityPointLaw};

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
            assert_same(
                &FrontPointField(&field).slope([yaw, yaw_rate, sideslip, steering]),
                &[slope.yaw, slope.yaw_rate, slope.sideslip, command.steering_rate],
            );

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
