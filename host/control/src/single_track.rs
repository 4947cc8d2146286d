//! The single-track model: the parameters of the car, the paper's equations 1 and 2, Newton's equations behind
//! them, and a model for a car that starts, stops, reverses and slides.
//!
//! Newton's equations have tyre forces that may saturate. With linear tyres, small angles and a
//! car that moves forward they are equation 1 itself, which [`SingleTrack`]
//! has as printed.

use libm::{atan, cos, tan};
use serde::{Deserialize, Serialize};

use crate::{Functions, Libm, Number, words};

/// Standard gravity, in m/s².
pub const GRAVITY: f64 = 9.806_65;

/// The parameters of the single-track model, in SI units.
///
/// Their type `P` is `f64`, or a dual number for derivatives by the parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleParameters<P = f64> {
    /// Mass m, in kg.
    pub mass_kg: P,
    /// Yaw moment of inertia `I_z` about the centre of mass, in kg m².
    pub yaw_inertia_kg_m2: P,
    /// Distance `l_f` from the centre of mass G to the front axle, in m.
    pub front_axle_distance_m: P,
    /// Distance `l_r` from the centre of mass G to the rear axle, in m.
    pub rear_axle_distance_m: P,
    /// Friction coefficient μ between tyre and ground.
    pub friction: P,
    /// Cornering stiffness `C_f` of the front axle, in N/rad.
    pub front_cornering_stiffness_n_rad: P,
    /// Cornering stiffness `C_r` of the rear axle, in N/rad.
    pub rear_cornering_stiffness_n_rad: P,
}

/// Length of a 1:10 car per wheelbase: the paper's is 0.4 m long.
const LENGTH_PER_WHEELBASE: f64 = 0.4 / 0.26;
/// Width of a 1:10 car per length: 0.19 m of 0.4 m.
const WIDTH_PER_LENGTH: f64 = 0.19 / 0.4;

/// A vehicle parameter that is not finite or not positive.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("vehicle parameter {name} is {value}: it must be finite and above zero")]
#[non_exhaustive]
pub struct VehicleParameterError {
    /// The parameter's name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
}

impl<P: Copy> VehicleParameters<P> {
    /// The paper's symbols for them, without friction: `m`, `I_z`, `l_f`, `l_r`, `C_f` and `C_r`.
    pub const fn symbols(&self) -> [P; 6] {
        [
            self.mass_kg,
            self.yaw_inertia_kg_m2,
            self.front_axle_distance_m,
            self.rear_axle_distance_m,
            self.front_cornering_stiffness_n_rad,
            self.rear_cornering_stiffness_n_rad,
        ]
    }
}

impl VehicleParameters {
    /// The 1:10 car of the paper (table "Experimental Platform Data").
    pub const fn paper() -> Self {
        Self {
            mass_kg: 1.9,
            yaw_inertia_kg_m2: 0.0251,
            front_axle_distance_m: 0.1368,
            rear_axle_distance_m: 0.1232,
            friction: 0.25,
            front_cornering_stiffness_n_rad: 58.085,
            rear_cornering_stiffness_n_rad: 130.805,
        }
    }

    /// Distance between the axles, `l_f + l_r`, in m.
    pub const fn wheelbase_m(&self) -> f64 {
        self.front_axle_distance_m + self.rear_axle_distance_m
    }

    /// Length of the body, in m, if it has the paper's car's for its wheelbase.
    pub const fn body_length_m(&self) -> f64 {
        LENGTH_PER_WHEELBASE * self.wheelbase_m()
    }

    /// Width of the body, in m, if it has the usual one of a 1:10 car of this length. It is for
    /// drawings only.
    pub const fn body_width_m(&self) -> f64 {
        WIDTH_PER_LENGTH * self.body_length_m()
    }

    /// This car with another centre of mass: `l_f` is `front_axle_distance_m`, and
    /// `l_r` is the rest of the wheelbase.
    #[must_use]
    pub const fn with_centre_of_mass_at(&self, front_axle_distance_m: f64) -> Self {
        Self {
            front_axle_distance_m,
            rear_axle_distance_m: self.wheelbase_m() - front_axle_distance_m,
            ..*self
        }
    }

    /// Checks that every parameter is finite and above zero.
    ///
    /// # Errors
    ///
    /// The first parameter that is not.
    pub fn validate(&self) -> Result<(), VehicleParameterError> {
        for (name, value) in [
            ("mass_kg", self.mass_kg),
            ("yaw_inertia_kg_m2", self.yaw_inertia_kg_m2),
            ("front_axle_distance_m", self.front_axle_distance_m),
            ("rear_axle_distance_m", self.rear_axle_distance_m),
            ("friction", self.friction),
            (
                "front_cornering_stiffness_n_rad",
                self.front_cornering_stiffness_n_rad,
            ),
            (
                "rear_cornering_stiffness_n_rad",
                self.rear_cornering_stiffness_n_rad,
            ),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(VehicleParameterError { name, value });
            }
        }
        Ok(())
    }
}

impl Default for VehicleParameters {
    fn default() -> Self {
        Self::paper()
    }
}

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

/// The time derivative of each value of a [`SingleTrackState`], per second.
pub type SingleTrackDerivative<N = f64> = SingleTrackState<N>;

impl<N: Number> SingleTrackState<N> {
    /// The lateral motion in this state at a speed of G, in m/s, and a steering angle, in rad.
    pub const fn lateral_motion(&self, speed: N, steering: N) -> LateralMotion<N> {
        LateralMotion {
            yaw_rate: self.yaw_rate,
            sideslip: self.sideslip,
            speed,
            steering,
        }
    }

    /// The derivative of this state: equation 2, with the lateral motion from elsewhere.
    ///
    /// `speed` is the speed v of G, in m/s, reverse negative.
    pub fn derivative<F: Functions<N>>(
        &self,
        speed: N,
        lateral: LateralRate<N>,
    ) -> SingleTrackDerivative<N> {
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
    pub const fn new(vehicle: VehicleParameters<P>) -> Self {
        Self { vehicle }
    }

    /// The parameters of the vehicle.
    pub const fn vehicle(&self) -> &VehicleParameters<P> {
        &self.vehicle
    }
}

impl<P: Number<P>> SingleTrack<P> {
    /// Equation 1 as printed: yaw acceleration and sideslip rate with linear tyres. The
    /// speed must be positive.
    pub fn lateral<N: Number<P>>(&self, motion: &LateralMotion<N>) -> LateralRate<N> {
        let [m, i_z, l_f, l_r, c_f, c_r] = self.vehicle.symbols();
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
    pub fn derivative(
        &self,
        state: &SingleTrackState,
        speed: f64,
        steering: f64,
    ) -> SingleTrackDerivative {
        let lateral = self.lateral(&state.lateral_motion(speed, steering));
        state.derivative::<Libm>(speed, lateral)
    }
}

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
    pub const fn vehicle(&self) -> &VehicleParameters<P> {
        &self.vehicle
    }
}

impl<P: Number<P>> Axles<P> {
    /// The axles of `vehicle` with `tyres`, for small angles.
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
    pub fn forces<F: Functions<N>, N: Number<P>>(
        &self,
        motion: &LateralMotion<N>,
    ) -> AxleForces<N> {
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
    fn exact_slip_angles<F: Functions<N>, N: Number<P>>(
        &self,
        motion: &LateralMotion<N>,
    ) -> [N; 2] {
        let (sine, cosine) = F::sin_cos(motion.sideslip);
        let (along, across) = (motion.speed * cosine, motion.speed * sine);
        let front = across + motion.yaw_rate * self.vehicle.front_axle_distance_m;
        let rear = across - motion.yaw_rate * self.vehicle.rear_axle_distance_m;
        let (sine, cosine) = F::sin_cos(motion.steering);
        // The components of the velocity of the front axle, along and across its wheels.
        let rolling = along * cosine + front * sine;
        let sliding = front * cosine - along * sine;
        [
            -F::atan2(sliding, magnitude(rolling)),
            -F::atan2(rear, magnitude(along)),
        ]
    }

    /// The force of an axle that would be `linear` without a limit, in N.
    fn force<F: Functions<N>, N: Number<P>>(&self, linear: N, limit: P) -> N {
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
    pub fn lateral<F: Functions<N>, N: Number<P>>(
        &self,
        motion: &LateralMotion<N>,
        forces: &AxleForces<N>,
    ) -> LateralRate<N> {
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
    pub fn new(vehicle: VehicleParameters) -> Self {
        Self::with_axles(Axles::new(vehicle, Tyres::Saturating))
    }

    /// The model with these axles.
    #[must_use]
    pub const fn with_axles(axles: Axles) -> Self {
        Self { axles }
    }

    /// The parameters of the vehicle.
    pub const fn vehicle(&self) -> &VehicleParameters {
        self.axles.vehicle()
    }

    /// The derivative at a speed of G (m/s, reverse negative) and a steering
    /// angle (rad, left positive).
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
        let vehicle = self.vehicle();
        let tangent = tan(steering);
        let sideslip = atan(vehicle.rear_axle_distance_m / vehicle.wheelbase_m() * tangent);
        let yaw_rate = speed * cos(sideslip) * tangent / vehicle.wheelbase_m();
        LateralRate {
            yaw_rate: (yaw_rate - state.yaw_rate) / RELAXATION_TIME,
            sideslip: (sideslip - state.sideslip) / RELAXATION_TIME,
        }
    }

    /// Newton's equations with the forces of the axles.
    fn dynamic(&self, state: &SingleTrackState, speed: f64, steering: f64) -> LateralRate {
        // The equations divide by the speed; below this one the kinematic model alone counts.
        let pace = speed.abs().max(KINEMATIC_BELOW);
        let motion = state.lateral_motion(if speed < 0.0 { -pace } else { pace }, steering);
        let forces = self.axles.forces::<Libm, f64>(&motion);
        self.axles.lateral::<Libm, f64>(&motion, &forces)
    }
}

/// 0 below 0, 1 above 1, smooth in between.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
