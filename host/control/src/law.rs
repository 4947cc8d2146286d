//! The feedback linearising laws.
//!
//! Each converts a velocity of its point P into commands for the car, so that P behaves
//! as two independent integrators: the front point of the law that the paper proposes, or the
//! point of the law of its appendix, with which that one is compared.

use libm::{cos, sin, sincos};

use crate::{Motion, Position, VehicleParameters, Velocity, direction};

/// The state is at a singularity of the law, or not finite.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Singularity {
    /// The front wheels are nearly perpendicular to the velocity: |cos(β - δ)|, given, is too small.
    #[error(
        "cos(sideslip - steering) is {0}, at the singularity of the law: \
         sideslip and steering are too far apart"
    )]
    WheelsAcrossVelocity(f64),
    /// The velocity-point law is singular at standstill: the speed that it would command, in m/s.
    #[error(
        "the speed is {0} m/s, at the singularity of the velocity-point law: it needs a car that moves"
    )]
    Standstill(f64),
    /// The state or the velocity is not finite.
    #[error("the law was given a state or a velocity that is not finite")]
    NotFinite,
}

/// An invalid parameter of a law.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LawError {
    /// The distance p must not be zero (paper, footnote to equation 3).
    #[error("point_distance_m is {0}: it must be finite and above zero")]
    PointDistance(f64),
    /// The estimate of `l_f` is outside the wheelbase, `l_f + l_r`: both, in m.
    #[error("front_axle_distance_m is {0}: it must lie between 0 and the wheelbase, {1}")]
    FrontAxleDistance(f64, f64),
}

/// The law counts as singular at a smaller |cos(β - δ)|, beyond 84 degrees.
const SMALLEST_COSINE: f64 = 0.1;

/// The proposed law, equation 7 (equation 8 when `l_f` is an estimate).
///
/// Its only parameters are the distance p of the point P from the front axle and the
/// distance `l_f` of the front axle from G.
///
/// ```
/// use singletrack_control::{FrontPointLaw, Motion, Velocity};
///
/// // l_f = 0.1368 m, p = 0.35 m, wheelbase 0.26 m.
/// let law = FrontPointLaw::new(0.1368, 0.35, 0.26)?;
/// let straight_on = Motion { yaw: 0.0, yaw_rate: 0.0, sideslip: 0.0 };
/// // P is to move forward with 0.5 m/s and to the left with 0.07 m/s.
/// let command = law.command(&straight_on, 0.0, &Velocity::new(0.5, 0.07))?;
/// assert_eq!(command.speed, 0.5);
/// // The sideways velocity over p.
/// assert!((command.steering_rate - 0.2).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontPointLaw {
    front_axle_distance: f64,
    point_distance: f64,
}

/// The command of the [`FrontPointLaw`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrontPointCommand {
    /// Speed v of G, in m/s.
    pub speed: f64,
    /// Rate `u_δ` of the steering angle, in rad/s.
    pub steering_rate: f64,
}

impl FrontPointLaw {
    /// The law for P at `point_distance` (p, m) ahead of a front axle that is
    /// `front_axle_distance` (`l_f` as estimated, m) ahead of G.
    ///
    /// # Errors
    ///
    /// p must be finite and above zero, and the estimate between 0 and the
    /// wheelbase, both ends included.
    pub fn new(
        front_axle_distance: f64,
        point_distance: f64,
        wheelbase: f64,
    ) -> Result<Self, LawError> {
        // An estimate written as l_f + l_r may exceed the wheelbase by a rounding error.
        if !(0.0..=wheelbase * (1.0 + 1e-9)).contains(&front_axle_distance) {
            return Err(LawError::FrontAxleDistance(front_axle_distance, wheelbase));
        }
        let law = Self {
            front_axle_distance,
            point_distance,
        };
        law.with_point_distance(point_distance)
    }

    /// This law for P at another distance p, in m.
    ///
    /// # Errors
    ///
    /// p must be finite and above zero.
    pub fn with_point_distance(self, point_distance: f64) -> Result<Self, LawError> {
        if !(point_distance.is_finite() && point_distance > 0.0) {
            return Err(LawError::PointDistance(point_distance));
        }
        Ok(Self {
            point_distance,
            ..self
        })
    }

    /// The distance p, in m.
    pub const fn point_distance(&self) -> f64 {
        self.point_distance
    }

    /// The distance `l_f` that the law uses, in m.
    pub const fn front_axle_distance(&self) -> f64 {
        self.front_axle_distance
    }

    /// The position of P by equation 3 with the law's own `l_f`.
    pub fn point(&self, centre_of_mass: Position, yaw: f64, steering: f64) -> Position {
        front_point(
            centre_of_mass,
            yaw,
            steering,
            self.front_axle_distance,
            self.point_distance,
        )
    }

    /// Speed and steering rate that give P the velocity `point_velocity`
    /// (world frame, m/s) at the steering angle `steering` (rad).
    ///
    /// # Errors
    ///
    /// Near the singularity cos(β - δ) = 0, and for a state or velocity that is not finite.
    pub fn command(
        &self,
        motion: &Motion,
        steering: f64,
        point_velocity: &Velocity,
    ) -> Result<FrontPointCommand, Singularity> {
        let Motion {
            yaw,
            yaw_rate,
            sideslip,
        } = *motion;
        let cosine = cos(sideslip - steering);
        if cosine.abs() < SMALLEST_COSINE {
            return Err(Singularity::WheelsAcrossVelocity(cosine));
        }
        let (sin_wheels, cos_wheels) = sincos(yaw + steering);
        let (sin_course, cos_course) = sincos(yaw + sideslip);
        let l_f = self.front_axle_distance;
        let command = FrontPointCommand {
            speed: (point_velocity.x * cos_wheels + point_velocity.y * sin_wheels
                - yaw_rate * l_f * sin(steering))
                / cosine,
            steering_rate: (point_velocity.y * cos_course
                - point_velocity.x * sin_course
                - yaw_rate * l_f * cos(sideslip))
                / (self.point_distance * cosine)
                - yaw_rate,
        };
        if command.speed.is_finite() && command.steering_rate.is_finite() {
            Ok(command)
        } else {
            Err(Singularity::NotFinite)
        }
    }
}

/// The law counts as singular below this speed, in m/s.
const SMALLEST_SPEED: f64 = 1e-3;

/// The alternative law of the appendix: P lies on the velocity vector of G.
///
/// Needs the mass, both cornering stiffnesses and both axle distances, and is
/// singular at standstill.
///
/// ```
/// use singletrack_control::{Motion, Singularity, VehicleParameters, Velocity, VelocityPointLaw};
///
/// let law = VelocityPointLaw::new(VehicleParameters::paper(), 0.35)?;
/// let straight_on = Motion { yaw: 0.0, yaw_rate: 0.0, sideslip: 0.0 };
/// let command = law.command(&straight_on, &Velocity::new(0.5, 0.07))?;
/// assert_eq!(command.speed, 0.5);
/// assert!(command.steering > 0.0, "to the left");
///
/// let standstill = law.command(&straight_on, &Velocity::zeros());
/// assert!(matches!(standstill, Err(Singularity::Standstill(_))));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityPointLaw {
    vehicle: VehicleParameters,
    point_distance: f64,
}

/// The command of the [`VelocityPointLaw`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VelocityPointCommand {
    /// Speed v of G, in m/s.
    pub speed: f64,
    /// Steering angle δ, in rad.
    pub steering: f64,
}

impl VelocityPointLaw {
    /// The law for P at `point_distance` (p, m) ahead of G, with the estimated parameters
    /// `vehicle`.
    ///
    /// # Errors
    ///
    /// p must be finite and above zero, and the estimate of `l_f` between 0 and the
    /// wheelbase, both ends included.
    pub fn new(vehicle: VehicleParameters, point_distance: f64) -> Result<Self, LawError> {
        let (l_f, wheelbase) = (vehicle.front_axle_distance_m, vehicle.wheelbase_m());
        FrontPointLaw::new(l_f, point_distance, wheelbase)?;
        Ok(Self {
            vehicle,
            point_distance,
        })
    }

    /// The distance p, in m.
    pub const fn point_distance(&self) -> f64 {
        self.point_distance
    }

    /// The position of P (appendix, first equation).
    pub fn point(&self, centre_of_mass: Position, yaw: f64, sideslip: f64) -> Position {
        velocity_point(centre_of_mass, yaw, sideslip, self.point_distance)
    }

    /// Speed and steering angle that give P the velocity `point_velocity`
    /// (world frame, m/s).
    ///
    /// # Errors
    ///
    /// Near v = 0, and for a state or velocity that is not finite.
    pub fn command(
        &self,
        motion: &Motion,
        point_velocity: &Velocity,
    ) -> Result<VelocityPointCommand, Singularity> {
        let (sine, cosine) = sincos(motion.yaw + motion.sideslip);
        let speed = point_velocity.x * cosine + point_velocity.y * sine;
        if speed.abs() < SMALLEST_SPEED {
            return Err(Singularity::Standstill(speed));
        }
        let turn_rate = (point_velocity.y * cosine - point_velocity.x * sine) / self.point_distance;
        let [m, _, l_f, l_r, c_f, c_r] = self.vehicle.symbols();
        let steering = m * turn_rate / c_f * speed
            - (c_r * l_r - c_f * l_f) / c_f * motion.yaw_rate / speed
            + (c_r + c_f) / c_f * motion.sideslip;
        if speed.is_finite() && steering.is_finite() {
            Ok(VelocityPointCommand { speed, steering })
        } else {
            Err(Singularity::NotFinite)
        }
    }
}

/// Equation 3: the point P, `point_distance` ahead of the front axle in the direction of
/// the front wheels. The front axle is `front_axle_distance` (`l_f`, true or estimated)
/// ahead of G. Angles are in rad, distances in m.
pub fn front_point(
    centre_of_mass: Position,
    yaw: f64,
    steering: f64,
    front_axle_distance: f64,
    point_distance: f64,
) -> Position {
    centre_of_mass
        + front_axle_distance * direction(yaw)
        + point_distance * direction(yaw + steering)
}

/// Equation 4: the velocity of the point P of [`front_point`], in m/s, when G moves with `speed`
/// (m/s) and the steering angle changes with `steering_rate` (rad/s).
pub fn front_point_velocity(
    law: &FrontPointLaw,
    motion: &Motion,
    steering: f64,
    speed: f64,
    steering_rate: f64,
) -> Velocity {
    let left = |angle: f64| {
        let (sine, cosine) = sincos(angle);
        Velocity::new(-sine, cosine)
    };
    let turn_of_wheels = motion.yaw_rate + steering_rate;
    speed * direction(motion.yaw + motion.sideslip)
        + law.front_axle_distance() * motion.yaw_rate * left(motion.yaw)
        + law.point_distance() * turn_of_wheels * left(motion.yaw + steering)
}

/// The appendix: the point P, `point_distance` (m) ahead of G in the direction of the
/// velocity of G. Angles are in rad.
pub fn velocity_point(
    centre_of_mass: Position,
    yaw: f64,
    sideslip: f64,
    point_distance: f64,
) -> Position {
    centre_of_mass + point_distance * direction(yaw + sideslip)
}
