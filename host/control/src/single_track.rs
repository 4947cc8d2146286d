//! The single-track model of the paper, equations 1 and 2.

use libm::{cos, sin};

use crate::VehicleParameters;

/// Where the car is and how it moves, in the world frame (x, y on the floor,
/// z up, yaw counter-clockwise from x).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleTrackState {
    /// Position of the centre of mass G along x, in m.
    pub x: f64,
    /// Position of the centre of mass G along y, in m.
    pub y: f64,
    /// Yaw ψ, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate r, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip β: the angle from the car's axis to the velocity of G, in rad.
    pub sideslip: f64,
}

/// The time derivative of a [`SingleTrackState`], per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleTrackDerivative {
    /// Velocity of G along x, in m/s.
    pub x: f64,
    /// Velocity of G along y, in m/s.
    pub y: f64,
    /// Yaw rate, in rad/s.
    pub yaw: f64,
    /// Yaw acceleration, in rad/s².
    pub yaw_rate: f64,
    /// Rate of the sideslip, in rad/s.
    pub sideslip: f64,
}

/// The single-track model: a vehicle whose speed and steering angle are inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleTrack {
    vehicle: VehicleParameters,
}

impl SingleTrack {
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

    /// Equations 1 and 2 as printed, with the speed v of G (m/s, positive)
    /// and the steering angle δ (rad, left positive) as inputs.
    ///
    /// Stiff at low speed (modes near -150/v and -72/v) and singular at v = 0:
    /// see [`crate::RelaxedSingleTrack`] for a car that starts and stops.
    #[must_use]
    pub fn derivative(
        &self,
        state: &SingleTrackState,
        speed: f64,
        steering: f64,
    ) -> SingleTrackDerivative {
        let VehicleParameters {
            mass_kg: m,
            yaw_inertia_kg_m2: i_z,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = self.vehicle;
        let SingleTrackState {
            yaw,
            yaw_rate,
            sideslip,
            ..
        } = *state;
        let moment = c_r * l_r - c_f * l_f;
        let course = yaw + sideslip;
        SingleTrackDerivative {
            x: speed * cos(course),
            y: speed * sin(course),
            yaw: yaw_rate,
            yaw_rate: moment / i_z * sideslip
                - (c_f * l_f * l_f + c_r * l_r * l_r) / (i_z * speed) * yaw_rate
                + c_f * l_f / i_z * steering,
            sideslip: -(c_f + c_r) / (m * speed) * sideslip
                + (moment / (m * speed * speed) - 1.0) * yaw_rate
                + c_f / (m * speed) * steering,
        }
    }
}
