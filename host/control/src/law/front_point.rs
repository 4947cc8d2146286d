//! The law that the paper proposes.

use libm::{cos, sin, sincos};

use super::{LawError, Motion, Singularity};
use crate::{Position, Velocity, front_point};

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
            return Err(LawError::FrontAxleDistance {
                value: front_axle_distance,
                wheelbase,
            });
        }
        let law = Self {
            front_axle_distance,
            point_distance,
        };
        law.with_point_distance(point_distance)
    }

    /// The same law for P at another distance p, in m.
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
    #[must_use]
    pub const fn point_distance(&self) -> f64 {
        self.point_distance
    }

    /// The distance `l_f` that the law uses, in m.
    #[must_use]
    pub const fn front_axle_distance(&self) -> f64 {
        self.front_axle_distance
    }

    /// The position of P by equation 3 with the law's own `l_f`.
    #[must_use]
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
            return Err(Singularity::WheelsAcrossVelocity { cosine });
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
