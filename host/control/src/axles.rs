//! Newton's equations behind equation 1, with tyre forces that may saturate.
//!
//! With linear tyres and a car that moves forward they are equation 1 itself, which
//! [`SingleTrack`](crate::SingleTrack) has as printed.

use crate::{Functions, GRAVITY, LateralMotion, LateralRate, Number, VehicleParameters};

/// The curve of an axle's lateral force over its slip angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tyres {
    /// Linear for small slip angles, with a smooth limit at μ times the axle's load.
    #[default]
    Saturating,
    /// The paper's: linear at every slip angle.
    Linear,
}

/// The lateral forces of both axles, positive to the left, in N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxleForces<N = f64> {
    /// `F_f`.
    pub front: N,
    /// `F_r`.
    pub rear: N,
}

/// A vehicle on two axles with [`Tyres`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axles<P = f64> {
    vehicle: VehicleParameters<P>,
    tyres: Tyres,
    /// The largest forces: μ times the load of each axle at rest.
    limits: AxleForces<P>,
}

impl<P> Axles<P> {
    /// The parameters of the vehicle.
    #[must_use]
    pub const fn vehicle(&self) -> &VehicleParameters<P> {
        &self.vehicle
    }
}

impl<P: Number<P>> Axles<P> {
    /// The axles of `vehicle` with `tyres`.
    #[must_use]
    pub fn new(vehicle: VehicleParameters<P>, tyres: Tyres) -> Self {
        let VehicleParameters {
            mass_kg: m,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            friction,
            ..
        } = vehicle;
        let weight_per_metre = m * P::from(GRAVITY) / (l_f + l_r);
        Self {
            vehicle,
            tyres,
            limits: AxleForces {
                front: friction * weight_per_metre * l_r,
                rear: friction * weight_per_metre * l_f,
            },
        }
    }

    /// The forces at the slip angles `δ - β - l_f r/v` and `-β + l_r r/v`.
    ///
    /// The speed must not be zero. In reverse |v| stands for v, and the angles δ and β
    /// change their signs, so that the forces damp the motion too.
    pub fn forces<F, N>(&self, motion: &LateralMotion<N>) -> AxleForces<N>
    where
        F: Functions<N>,
        N: Number<P>,
    {
        let vehicle = &self.vehicle;
        let LateralMotion {
            yaw_rate,
            sideslip,
            speed,
            steering,
        } = *motion;
        let (pace, front, rear) = if speed < N::from(0.0_f64) {
            (-speed, -(steering - sideslip), sideslip)
        } else {
            (speed, steering - sideslip, -sideslip)
        };
        let front_slip = front - yaw_rate * vehicle.front_axle_distance_m / pace;
        let rear_slip = rear + yaw_rate * vehicle.rear_axle_distance_m / pace;
        AxleForces {
            front: self.force::<F, N>(
                front_slip * vehicle.front_cornering_stiffness_n_rad,
                self.limits.front,
            ),
            rear: self.force::<F, N>(
                rear_slip * vehicle.rear_cornering_stiffness_n_rad,
                self.limits.rear,
            ),
        }
    }

    /// The force of an axle that would be `linear` without a limit, in N.
    fn force<F, N>(&self, linear: N, limit: P) -> N
    where
        F: Functions<N>,
        N: Number<P>,
    {
        match self.tyres {
            Tyres::Saturating => F::tanh(linear / limit) * limit,
            Tyres::Linear => linear,
        }
    }

    /// Newton's equations for yaw and lateral motion under these forces.
    ///
    /// The speed must not be zero.
    pub fn lateral<N: Number<P>>(
        &self,
        motion: &LateralMotion<N>,
        forces: &AxleForces<N>,
    ) -> LateralRate<N> {
        let vehicle = &self.vehicle;
        let moment = forces.front * vehicle.front_axle_distance_m
            - forces.rear * vehicle.rear_axle_distance_m;
        LateralRate {
            yaw_rate: moment / vehicle.yaw_inertia_kg_m2,
            sideslip: (forces.front + forces.rear) / (motion.speed * vehicle.mass_kg)
                - motion.yaw_rate,
        }
    }
}
