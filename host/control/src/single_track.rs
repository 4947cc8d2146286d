//! The single-track model of the paper, equations 1 and 2.

use crate::{Functions, Libm, Number, VehicleParameters};

/// Pose and lateral motion of the car, in the world frame (x, y on the floor,
/// z up, yaw counter-clockwise from x).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleTrackState<N = f64> {
    /// Position of the centre of mass G along x, in m.
    pub x: N,
    /// Position of the centre of mass G along y, in m.
    pub y: N,
    /// Yaw ψ, in rad, not wrapped.
    pub yaw: N,
    /// Yaw rate r, in rad/s.
    pub yaw_rate: N,
    /// Sideslip β: the angle from the car's axis to the velocity of G, in rad.
    pub sideslip: N,
}

/// The time derivative of a [`SingleTrackState`], per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleTrackDerivative<N = f64> {
    /// Velocity of G along x, in m/s.
    pub x: N,
    /// Velocity of G along y, in m/s.
    pub y: N,
    /// Yaw rate, in rad/s.
    pub yaw: N,
    /// Yaw acceleration, in rad/s².
    pub yaw_rate: N,
    /// Rate of the sideslip, in rad/s.
    pub sideslip: N,
}

impl<N: Copy> SingleTrackState<N> {
    /// The derivative of this state: equation 2, with the lateral motion from elsewhere.
    ///
    /// `speed` is the speed v of G, in m/s, reverse negative.
    pub fn derivative<F: Functions<N>>(
        &self,
        speed: N,
        lateral: LateralRate<N>,
    ) -> SingleTrackDerivative<N>
    where
        N: Number,
    {
        let (sine, cosine) = F::sin_cos(self.yaw + self.sideslip);
        SingleTrackDerivative {
            x: speed * cosine,
            y: speed * sine,
            yaw: self.yaw_rate,
            yaw_rate: lateral.yaw_rate,
            sideslip: lateral.sideslip,
        }
    }
}

/// The variables of equation 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LateralMotion<N = f64> {
    /// Yaw rate r, in rad/s.
    pub yaw_rate: N,
    /// Sideslip β, in rad.
    pub sideslip: N,
    /// Speed v of G, in m/s.
    pub speed: N,
    /// Steering angle δ, left positive, in rad.
    pub steering: N,
}

/// The time derivative of the lateral motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LateralRate<N = f64> {
    /// Yaw acceleration, in rad/s².
    pub yaw_rate: N,
    /// Rate of the sideslip, in rad/s.
    pub sideslip: N,
}

/// The single-track model: a vehicle whose speed and steering angle are inputs.
///
/// The parameters are of type `P`; each method is generic over the [`Number`] of the motion.
///
/// ```
/// use singletrack_control::{SingleTrack, SingleTrackState, VehicleParameters};
///
/// let model = SingleTrack::new(VehicleParameters::paper());
/// let straight_on = SingleTrackState::default();
/// // 0.8 m/s along the world's x axis, with the wheels 0.1 rad to the left.
/// let rate = model.derivative(&straight_on, 0.8, 0.1);
/// assert_eq!((rate.x, rate.y, rate.yaw), (0.8, 0.0, 0.0));
/// // C_f l_f δ / I_z: the front axle begins to turn the car.
/// let yaw_acceleration = 58.085 * 0.1368 * 0.1 / 0.0251;
/// assert!((rate.yaw_rate - yaw_acceleration).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleTrack<P = f64> {
    vehicle: VehicleParameters<P>,
}

impl<P> SingleTrack<P> {
    /// The model of `vehicle`.
    #[must_use]
    pub const fn new(vehicle: VehicleParameters<P>) -> Self {
        Self { vehicle }
    }

    /// The parameters of the vehicle.
    #[must_use]
    pub const fn vehicle(&self) -> &VehicleParameters<P> {
        &self.vehicle
    }
}

impl<P: Number<P>> SingleTrack<P> {
    /// Equation 1 as printed: yaw acceleration and sideslip rate with linear tyres. The
    /// speed must be positive.
    pub fn lateral<N: Number<P>>(&self, motion: &LateralMotion<N>) -> LateralRate<N> {
        let VehicleParameters {
            mass_kg: m,
            yaw_inertia_kg_m2: i_z,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = self.vehicle;
        let LateralMotion {
            yaw_rate,
            sideslip,
            speed,
            steering,
        } = *motion;
        let moment = c_r * l_r - c_f * l_f;
        let damping = c_f * l_f * l_f + c_r * l_r * l_r;
        LateralRate {
            yaw_rate: sideslip * (moment / i_z) - N::from(damping) / (speed * i_z) * yaw_rate
                + steering * (c_f * l_f / i_z),
            sideslip: N::from(-(c_f + c_r)) / (speed * m) * sideslip
                + (N::from(moment) / (speed * m * speed) - N::from(1.0_f64)) * yaw_rate
                + N::from(c_f) / (speed * m) * steering,
        }
    }
}

impl SingleTrack {
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
        let lateral = self.lateral(&LateralMotion {
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
            speed,
            steering,
        });
        state.derivative::<Libm>(speed, lateral)
    }
}
