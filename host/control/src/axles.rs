//! Newton's equations behind equation 1, with tyre forces that may saturate.
//!
//! With linear tyres, small angles and a car that moves forward they are equation 1 itself,
//! which [`SingleTrack`](crate::SingleTrack) has as printed.

use serde::{Deserialize, Serialize};
use singletrack_words::words;

use crate::{Functions, GRAVITY, LateralMotion, LateralRate, Number, VehicleParameters};

words! {
    /// The curve of an axle's lateral force over its slip angle.
    #[derive(Default)]
    pub enum Tyres: serde {
        /// A hyperbolic tangent: linear for small slip angles, with a smooth limit at μ times the
        /// axle's load.
        #[default]
        Saturating = "saturating",
        /// The paper's: linear at every slip angle.
        Linear = "linear",
        /// Pacejka's magic formula `D sin(C atan(B α))` with D = μ times the axle's load, C = 1.3
        /// and B C D the cornering stiffness: beyond a peak the force falls, to 0.89 D.
        MagicFormula = "magic-formula",
    }
}

/// The shape factor C of [`Tyres::MagicFormula`], a usual one for lateral forces.
const SHAPE: f64 = 1.3;

/// How slip angles and forces follow from sideslip and steering.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SlipAngles {
    /// The paper's: sin x = x and cos x = 1.
    #[default]
    Small,
    /// The slip angle is the angle between the wheels and the velocity of their axle, and the
    /// front force acts across the front wheels: cos δ of it acts across the car.
    Exact,
}

/// The forces of both axles across their wheels, positive to the left, in N.
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
    slip_angles: SlipAngles,
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
    /// The axles of `vehicle` with `tyres`, for small angles.
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
            slip_angles: SlipAngles::Small,
            limits: AxleForces {
                front: friction * weight_per_metre * l_r,
                rear: friction * weight_per_metre * l_f,
            },
        }
    }

    /// These axles with other slip angles.
    #[must_use]
    pub fn with_slip_angles(self, slip_angles: SlipAngles) -> Self {
        Self {
            slip_angles,
            ..self
        }
    }

    /// The forces at the slip angles of a motion.
    ///
    /// The speed must not be zero. In reverse |v| stands for v, and the angles δ and β
    /// change their signs, so that the forces damp the motion too.
    pub fn forces<F, N>(&self, motion: &LateralMotion<N>) -> AxleForces<N>
    where
        F: Functions<N>,
        N: Number<P>,
    {
        let vehicle = &self.vehicle;
        let [front, rear] = match self.slip_angles {
            SlipAngles::Small => self.small_slip_angles(motion),
            SlipAngles::Exact => self.exact_slip_angles::<F, N>(motion),
        };
        AxleForces {
            front: self.force::<F, N>(
                front * vehicle.front_cornering_stiffness_n_rad,
                self.limits.front,
            ),
            rear: self.force::<F, N>(
                rear * vehicle.rear_cornering_stiffness_n_rad,
                self.limits.rear,
            ),
        }
    }

    /// `δ - β - l_f r/v` and `-β + l_r r/v`, in rad.
    fn small_slip_angles<N: Number<P>>(&self, motion: &LateralMotion<N>) -> [N; 2] {
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
        [
            front - yaw_rate * self.vehicle.front_axle_distance_m / pace,
            rear + yaw_rate * self.vehicle.rear_axle_distance_m / pace,
        ]
    }

    /// The angles between the velocities of the axles and their wheels, in rad.
    fn exact_slip_angles<F, N>(&self, motion: &LateralMotion<N>) -> [N; 2]
    where
        F: Functions<N>,
        N: Number<P>,
    {
        let (sine, cosine) = F::sin_cos(motion.sideslip);
        let (along, across) = (motion.speed * cosine, motion.speed * sine);
        let front = across + motion.yaw_rate * self.vehicle.front_axle_distance_m;
        let rear = across - motion.yaw_rate * self.vehicle.rear_axle_distance_m;
        let (sine, cosine) = F::sin_cos(motion.steering);
        // Of the velocity of the front axle, along and across its wheels.
        let rolling = along * cosine + front * sine;
        let sliding = front * cosine - along * sine;
        [
            -F::atan2(sliding, magnitude(rolling)),
            -F::atan2(rear, magnitude(along)),
        ]
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
            Tyres::MagicFormula => {
                let shape = N::from(SHAPE);
                let angle = F::atan2(linear / limit / shape, N::from(1.0_f64));
                let (sine, _) = F::sin_cos(shape * angle);
                sine * limit
            }
        }
    }

    /// Newton's equations for yaw and lateral motion under these forces.
    ///
    /// The speed must not be zero. With exact slip angles the rear wheels keep their speed
    /// v cos β; what the forces do along the car is the motor's to overcome.
    pub fn lateral<F, N>(&self, motion: &LateralMotion<N>, forces: &AxleForces<N>) -> LateralRate<N>
    where
        F: Functions<N>,
        N: Number<P>,
    {
        let vehicle = &self.vehicle;
        let front = match self.slip_angles {
            SlipAngles::Small => forces.front,
            SlipAngles::Exact => forces.front * F::sin_cos(motion.steering).1,
        };
        let moment =
            front * vehicle.front_axle_distance_m - forces.rear * vehicle.rear_axle_distance_m;
        let acceleration = (front + forces.rear) / (motion.speed * vehicle.mass_kg);
        LateralRate {
            yaw_rate: moment / vehicle.yaw_inertia_kg_m2,
            sideslip: match self.slip_angles {
                SlipAngles::Small => acceleration - motion.yaw_rate,
                SlipAngles::Exact => {
                    let cosine = F::sin_cos(motion.sideslip).1;
                    (acceleration - motion.yaw_rate * cosine) * cosine
                }
            },
        }
    }
}

fn magnitude<N: Number<P>, P>(x: N) -> N {
    if x < N::from(0.0_f64) { -x } else { x }
}
