//! The single-track model for a car that starts, stops, reverses and slides.

use libm::{atan, cos, tan};

use crate::{
    Axles, LateralMotion, LateralRate, Libm, SingleTrackDerivative, SingleTrackState, Tyres,
    VehicleParameters,
};

/// Below this speed the car follows the kinematic model, in m/s.
const KINEMATIC_BELOW: f64 = 0.08;
/// Above this speed the car follows the dynamic model, in m/s.
const DYNAMIC_ABOVE: f64 = 0.16;
/// Time in which yaw rate and sideslip relax to the kinematic model, in s.
const RELAXATION_TIME: f64 = 0.02;

/// The single-track model with three additions, for a simulated car:
///
/// - below about 0.1 m/s yaw rate and sideslip relax to the kinematic model,
///   where the dynamic one is stiff (RK4 at 1 kHz is unstable below 0.054 m/s)
///   and at standstill undefined;
/// - the slip angles are formed with |v|, so that reversing is damped too;
/// - the lateral force of an axle saturates smoothly at μ times its load, or has another curve.
///
/// At higher speeds forward it is equation 1 to first order in the slip angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxedSingleTrack {
    axles: Axles,
}

impl RelaxedSingleTrack {
    /// The model of `vehicle`.
    #[must_use]
    pub fn new(vehicle: VehicleParameters) -> Self {
        Self::with_axles(Axles::new(vehicle, Tyres::Saturating))
    }

    /// The model with these axles.
    #[must_use]
    pub const fn with_axles(axles: Axles) -> Self {
        Self { axles }
    }

    /// The parameters of the vehicle.
    #[must_use]
    pub const fn vehicle(&self) -> &VehicleParameters {
        self.axles.vehicle()
    }

    /// Sideslip without tyre slip at a steering angle, in rad.
    #[must_use]
    pub fn kinematic_sideslip(&self, steering: f64) -> f64 {
        self.kinematic_sideslip_of_tangent(tan(steering))
    }

    fn kinematic_sideslip_of_tangent(&self, tangent: f64) -> f64 {
        let vehicle = self.vehicle();
        atan(vehicle.rear_axle_distance_m / vehicle.wheelbase_m() * tangent)
    }

    /// The derivative at a speed of G (m/s, reverse negative) and a steering
    /// angle (rad, left positive).
    #[must_use]
    pub fn derivative(
        &self,
        state: &SingleTrackState,
        speed: f64,
        steering: f64,
    ) -> SingleTrackDerivative {
        let weight =
            smooth_step((speed.abs() - KINEMATIC_BELOW) / (DYNAMIC_ABOVE - KINEMATIC_BELOW));
        let lateral = if weight <= 0.0 {
            self.kinematic(state, speed, steering)
        } else if weight >= 1.0 {
            self.dynamic(state, speed, steering)
        } else {
            let kinematic = self.kinematic(state, speed, steering);
            let dynamic = self.dynamic(state, speed, steering);
            LateralRate {
                yaw_rate: kinematic.yaw_rate + weight * (dynamic.yaw_rate - kinematic.yaw_rate),
                sideslip: kinematic.sideslip + weight * (dynamic.sideslip - kinematic.sideslip),
            }
        };
        state.derivative::<Libm>(speed, lateral)
    }

    /// Relaxation of yaw rate and sideslip to rolling without slip.
    fn kinematic(&self, state: &SingleTrackState, speed: f64, steering: f64) -> LateralRate {
        let tangent = tan(steering);
        let sideslip = self.kinematic_sideslip_of_tangent(tangent);
        let yaw_rate = speed * cos(sideslip) * tangent / self.vehicle().wheelbase_m();
        LateralRate {
            yaw_rate: (yaw_rate - state.yaw_rate) / RELAXATION_TIME,
            sideslip: (sideslip - state.sideslip) / RELAXATION_TIME,
        }
    }

    /// Newton's equations with the forces of the axles.
    fn dynamic(&self, state: &SingleTrackState, speed: f64, steering: f64) -> LateralRate {
        // The equations divide by the speed; below this one the kinematic model alone counts.
        let pace = speed.abs().max(KINEMATIC_BELOW);
        let motion = LateralMotion {
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
            speed: if speed < 0.0 { -pace } else { pace },
            steering,
        };
        let forces = self.axles.forces::<Libm, f64>(&motion);
        self.axles.lateral::<Libm, f64>(&motion, &forces)
    }
}

/// 0 below 0, 1 above 1, smooth in between.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
