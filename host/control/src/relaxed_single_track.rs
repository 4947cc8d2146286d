//! The single-track model for a car that starts, stops, reverses and slides.

use libm::{atan, cos, sin, tan, tanh};

use crate::{GRAVITY, SingleTrackDerivative, SingleTrackState, VehicleParameters};

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
/// - the lateral force of an axle saturates smoothly at μ times its load.
///
/// In between it is equation 1 to first order in the slip angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxedSingleTrack {
    vehicle: VehicleParameters,
}

impl RelaxedSingleTrack {
    /// The model of `vehicle`.
    #[must_use]
    pub const fn new(vehicle: VehicleParameters) -> Self {
        Self { vehicle }
    }

    /// The vehicle that this is a model of.
    #[must_use]
    pub const fn vehicle(&self) -> &VehicleParameters {
        &self.vehicle
    }

    /// Sideslip without tyre slip at a steering angle, in rad.
    #[must_use]
    pub fn kinematic_sideslip(&self, steering: f64) -> f64 {
        atan(self.vehicle.rear_axle_distance_m / self.vehicle.wheelbase_m() * tan(steering))
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
        let (yaw_acceleration, sideslip_rate) = {
            let weight =
                smooth_step((speed.abs() - KINEMATIC_BELOW) / (DYNAMIC_ABOVE - KINEMATIC_BELOW));
            let kinematic = self.kinematic(state, speed, steering);
            let dynamic = self.dynamic(state, speed, steering);
            (
                kinematic.0 + weight * (dynamic.0 - kinematic.0),
                kinematic.1 + weight * (dynamic.1 - kinematic.1),
            )
        };
        let course = state.yaw + state.sideslip;
        SingleTrackDerivative {
            x: speed * cos(course),
            y: speed * sin(course),
            yaw: state.yaw_rate,
            yaw_rate: yaw_acceleration,
            sideslip: sideslip_rate,
        }
    }

    /// Relaxation of yaw rate and sideslip to rolling without slip.
    fn kinematic(&self, state: &SingleTrackState, speed: f64, steering: f64) -> (f64, f64) {
        let sideslip = self.kinematic_sideslip(steering);
        let yaw_rate = speed * cos(sideslip) * tan(steering) / self.vehicle.wheelbase_m();
        (
            (yaw_rate - state.yaw_rate) / RELAXATION_TIME,
            (sideslip - state.sideslip) / RELAXATION_TIME,
        )
    }

    /// Newton's equations with saturating axle forces.
    fn dynamic(&self, state: &SingleTrackState, speed: f64, steering: f64) -> (f64, f64) {
        let v = &self.vehicle;
        let direction = if speed < 0.0 { -1.0 } else { 1.0 };
        // Never divided by less: below it the kinematic model alone counts.
        let pace = speed.abs().max(KINEMATIC_BELOW);
        let front_slip = direction * (steering - state.sideslip)
            - v.front_axle_distance_m * state.yaw_rate / pace;
        let rear_slip =
            -direction * state.sideslip + v.rear_axle_distance_m * state.yaw_rate / pace;
        let weight = v.mass_kg * GRAVITY / v.wheelbase_m();
        let front_force = axle_force(
            v.front_cornering_stiffness_n_rad * front_slip,
            v.friction * weight * v.rear_axle_distance_m,
        );
        let rear_force = axle_force(
            v.rear_cornering_stiffness_n_rad * rear_slip,
            v.friction * weight * v.front_axle_distance_m,
        );
        (
            (v.front_axle_distance_m * front_force - v.rear_axle_distance_m * rear_force)
                / v.yaw_inertia_kg_m2,
            (front_force + rear_force) / (v.mass_kg * direction * pace) - state.yaw_rate,
        )
    }
}

/// The linear force, saturating smoothly at `limit`.
fn axle_force(linear: f64, limit: f64) -> f64 {
    limit * tanh(linear / limit)
}

/// 0 below 0, 1 above 1, smooth in between.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
