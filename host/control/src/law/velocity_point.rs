//! The law of the paper's appendix, which the proposed law is compared with.

use libm::sincos;

use super::{LawError, Motion, Singularity};
use crate::{Position, VehicleParameters, Velocity, velocity_point};

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
/// assert!(matches!(standstill, Err(Singularity::Standstill { .. })));
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
        if !(point_distance.is_finite() && point_distance > 0.0) {
            return Err(LawError::PointDistance(point_distance));
        }
        let wheelbase = vehicle.wheelbase_m();
        let l_f = vehicle.front_axle_distance_m;
        if !(0.0..=wheelbase * (1.0 + 1e-9)).contains(&l_f) {
            return Err(LawError::FrontAxleDistance {
                value: l_f,
                wheelbase,
            });
        }
        Ok(Self {
            vehicle,
            point_distance,
        })
    }

    /// The distance p, in m.
    #[must_use]
    pub const fn point_distance(&self) -> f64 {
        self.point_distance
    }

    /// The position of P (appendix, first equation).
    #[must_use]
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
            return Err(Singularity::Standstill { speed });
        }
        let turn_rate = (point_velocity.y * cosine - point_velocity.x * sine) / self.point_distance;
        let VehicleParameters {
            mass_kg: m,
            front_axle_distance_m: l_f,
            rear_axle_distance_m: l_r,
            front_cornering_stiffness_n_rad: c_f,
            rear_cornering_stiffness_n_rad: c_r,
            ..
        } = self.vehicle;
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
