//! The closed loop: a car under a linearising law that may assume a wrong centre of mass.

use singletrack_control::{SlipAngles, Tyres, VehicleParameterError, VehicleParameters, words};

words! {
    /// A linearising law.
    pub enum Law {
        /// The proposed law, equation 8: P is ahead of the front axle.
        FrontPoint = "front-point",
        /// The law of the appendix: P is ahead of G in the direction of its velocity.
        VelocityPoint = "velocity-point",
    }
}

words! {
    /// The distances that are wrong in the law.
    ///
    /// The [`Law::FrontPoint`] has only `l_f`.
    pub enum Belief {
        /// The position of the centre of mass on a known wheelbase: `l_f + dl` and `l_r - dl`.
        /// The paper's threshold of 0.136 mm is of this kind.
        CentreOfMass = "centre-of-mass",
        /// The position of the front axle alone: `l_f + dl`, with the true `l_r`.
        FrontAxle = "front-axle",
    }
}

/// What bounds a large motion. The linearisation at the steady motion does not depend on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturation {
    /// The tyres, with the friction of the vehicle.
    pub tyres: Tyres,
    /// Slip angles of the paper, or exact ones. It matters for basins: with small ones both axles may
    /// saturate in exact balance, and the car spins.
    pub slip_angles: SlipAngles,
    /// The largest steering angle, in rad. The front-point law's integrator stops there, and
    /// leaves the stop as soon as the law steers back.
    pub max_steering: f64,
    /// The largest steering rate, in rad/s; of the front-point law alone, whose command it is.
    pub max_steering_rate: f64,
}

impl Saturation {
    /// None: linear tyres and no limits.
    pub const NONE: Self = Self {
        tyres: Tyres::Linear,
        slip_angles: SlipAngles::Small,
        max_steering: f64::INFINITY,
        max_steering_rate: f64::INFINITY,
    };
}

/// A car under a law that may assume a wrong centre of mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedLoop {
    pub(super) vehicle: VehicleParameters,
    pub(super) law: Law,
    pub(super) belief: Belief,
    pub(super) point_distance: f64,
    pub(super) speed: f64,
    pub(super) deviation: f64,
    pub(super) saturation: Saturation,
}

/// Parameters with which there is no steady motion.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StabilityError {
    /// The parameters of the vehicle are invalid.
    #[error(transparent)]
    Vehicle(#[from] VehicleParameterError),
    /// The distance p is invalid.
    #[error("the point distance p is {0} m: it must be finite and above zero")]
    PointDistance(f64),
    /// The model has no steady motion at standstill or in reverse.
    #[error("the speed is {0} m/s: the model needs a car that moves forward, above zero")]
    Speed(f64),
    /// The deviation is not finite.
    #[error("the deviation dl of the centre of mass is {0} m: it must be finite")]
    Deviation(f64),
    /// A limit of the steering leaves nothing.
    #[error("the largest steering {name} is {limit} {unit}: it must be above zero")]
    SteeringLimit {
        /// What is limited: angle or rate.
        name: &'static str,
        /// Its value.
        limit: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// A servo that the basin does not model.
    #[error(
        "the basin is that of the front-point law with a servo of lag and dead time above zero: \
         give both, or none"
    )]
    Servo,
    /// A law whose region of attraction is not computed.
    #[error("a region of attraction is that of the front-point law: choose this law")]
    Attraction,
    /// The parameters are finite, but the equations overflow.
    #[error(
        "with a speed of {speed:e} m/s, p = {point_distance:e} m and dl = {deviation:e} m the equations \
         leave the range of numbers: choose realistic values"
    )]
    Extreme {
        /// The speed, in m/s.
        speed: f64,
        /// The distance p, in m.
        point_distance: f64,
        /// The deviation dl, in m.
        deviation: f64,
    },
}

impl ClosedLoop {
    /// `vehicle` under `law` with P at `point_distance` (p, m), in steady motion at `speed`
    /// (m/s). The law assumes the centre of mass `deviation` (`dl`, m) behind its true
    /// position.
    ///
    /// `dl` is physically meaningful in [`ClosedLoop::meaningful_deviations`]. Any finite
    /// value is accepted, because bifurcations lie outside that range.
    ///
    /// # Errors
    ///
    /// A parameter with which there is no steady motion.
    pub fn new(
        vehicle: VehicleParameters,
        law: Law,
        point_distance: f64,
        speed: f64,
        deviation: f64,
    ) -> Result<Self, StabilityError> {
        Self {
            vehicle,
            law,
            belief: Belief::CentreOfMass,
            point_distance,
            speed,
            deviation,
            saturation: Saturation::NONE,
        }
        .checked()
    }

    /// This loop, if its parameters are valid, and if its Jacobian and its characteristic
    /// polynomial are finite.
    fn checked(self) -> Result<Self, StabilityError> {
        let (p, v, deviation) = (self.point_distance, self.speed, self.deviation);
        self.vehicle.validate()?;
        if !(p.is_finite() && p > 0.0) {
            return Err(StabilityError::PointDistance(p));
        }
        if !(v.is_finite() && v > 0.0) {
            return Err(StabilityError::Speed(v));
        }
        if !deviation.is_finite() {
            return Err(StabilityError::Deviation(deviation));
        }
        // What the entries of the Jacobian contain besides the car's parameters.
        let factors = [
            v,
            v * v,
            1.0 / v,
            1.0 / (v * v),
            v / p,
            deviation / p,
            1.0 / p,
        ];
        let is_finite = factors.iter().all(|factor| factor.is_finite())
            && self.characteristic_polynomial().is_finite();
        is_finite.then_some(self).ok_or(StabilityError::Extreme {
            speed: v,
            point_distance: p,
            deviation,
        })
    }

    /// The car.
    pub const fn vehicle(&self) -> VehicleParameters {
        self.vehicle
    }

    /// This loop with other distances wrong.
    #[must_use]
    pub const fn believing(self, belief: Belief) -> Self {
        Self { belief, ..self }
    }

    /// This loop with tyres and steering that saturate.
    ///
    /// # Errors
    ///
    /// A limit that is not above zero.
    pub fn saturating(self, saturation: Saturation) -> Result<Self, StabilityError> {
        for (name, limit, unit) in [
            ("angle", saturation.max_steering, "rad"),
            ("rate", saturation.max_steering_rate, "rad/s"),
        ] {
            // Not a number is not above zero.
            let is_valid = limit > 0.0;
            if !is_valid {
                return Err(StabilityError::SteeringLimit { name, limit, unit });
            }
        }
        Ok(Self { saturation, ..self })
    }

    /// This loop with the assumed centre of mass `deviation` (`dl`, m) behind its true
    /// position.
    ///
    /// # Errors
    ///
    /// A deviation that is not finite.
    pub fn with_deviation(self, deviation: f64) -> Result<Self, StabilityError> {
        Self { deviation, ..self }.checked()
    }

    /// This loop at another speed, in m/s.
    ///
    /// # Errors
    ///
    /// A speed without a steady motion.
    pub fn with_speed(self, speed: f64) -> Result<Self, StabilityError> {
        Self { speed, ..self }.checked()
    }

    /// This loop with another distance p, in m.
    ///
    /// # Errors
    ///
    /// An invalid distance.
    pub fn with_point_distance(mut self, point_distance: f64) -> Result<Self, StabilityError> {
        self.point_distance = point_distance;
        self.checked()
    }

    /// The range of physically meaningful deviations, from `-l_f` to `l_r`: the assumed
    /// centre of mass is between the axles.
    pub const fn meaningful_deviations(vehicle: &VehicleParameters) -> [f64; 2] {
        [-vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m]
    }
}
