//! The car under a linearising law that may have a wrong centre of mass.

use singletrack_control::{VehicleParameterError, VehicleParameters};

/// A linearising law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// The proposed one, equation 8: P is before the front axle.
    FrontPoint,
    /// That of the appendix: P is before G in the direction of its velocity.
    VelocityPoint,
}

/// Which of its distances the law has wrong.
///
/// The [`Law::FrontPoint`] knows only one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Belief {
    /// The centre of mass is believed elsewhere on a wheelbase that is known:
    /// `l_f + dl` and `l_r - dl`. The paper's threshold of 0.136 mm is of this kind.
    #[default]
    CentreOfMass,
    /// The front axle alone is believed elsewhere: `l_f + dl`, and `l_r` as it is.
    FrontAxle,
}

/// A car under a law that believes its centre of mass elsewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedLoop {
    pub(super) vehicle: VehicleParameters,
    pub(super) law: Law,
    pub(super) belief: Belief,
    pub(super) point_distance: f64,
    pub(super) speed: f64,
    pub(super) deviation: f64,
}

/// A closed loop that has no steady motion to look at.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StabilityError {
    /// No such car.
    #[error(transparent)]
    Vehicle(#[from] VehicleParameterError),
    /// P is nowhere, or where the law is singular.
    #[error("the point distance p is {0} m: it must be finite and above zero")]
    PointDistance(f64),
    /// The model has no steady motion at standstill, and none backwards.
    #[error("the speed is {0} m/s: the model needs a car that moves forward, above zero")]
    Speed(f64),
    /// No distance.
    #[error("the deviation dl of the centre of mass is {0} m: it must be finite")]
    Deviation(f64),
    /// Finite, but nothing to compute with.
    #[error(
        "with a speed of {speed:e} m/s, p = {point_distance:e} m and dl = {deviation:e} m the equations \
         leave the range of numbers: choose what a car can have"
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
    /// `vehicle` under `law`, P at `point_distance` (p, m), moving steadily at
    /// `speed` (m/s), with the centre of mass believed `deviation` (`dl`, m) behind
    /// where it is.
    ///
    /// `dl` is physically meaningful in [`ClosedLoop::meaningful_deviations`]; any
    /// finite value is accepted, as bifurcations lie beyond.
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
        vehicle.validate()?;
        if !(point_distance.is_finite() && point_distance > 0.0) {
            return Err(StabilityError::PointDistance(point_distance));
        }
        if !(speed.is_finite() && speed > 0.0) {
            return Err(StabilityError::Speed(speed));
        }
        if !deviation.is_finite() {
            return Err(StabilityError::Deviation(deviation));
        }
        Self {
            vehicle,
            law,
            belief: Belief::default(),
            point_distance,
            speed,
            deviation,
        }
        .finite()
    }

    /// Refuses what is so extreme that it can't be computed with.
    fn finite(self) -> Result<Self, StabilityError> {
        if self.jacobian().iter().all(|entry| entry.is_finite()) {
            Ok(self)
        } else {
            Err(StabilityError::Extreme {
                speed: self.speed,
                point_distance: self.point_distance,
                deviation: self.deviation,
            })
        }
    }

    /// The same with other distances wrong.
    #[must_use]
    pub const fn believing(self, belief: Belief) -> Self {
        Self { belief, ..self }
    }

    /// The same with the centre of mass believed `deviation` (`dl`, m) behind where
    /// it is.
    ///
    /// # Errors
    ///
    /// A deviation that is not finite.
    pub fn with_deviation(self, deviation: f64) -> Result<Self, StabilityError> {
        if !deviation.is_finite() {
            return Err(StabilityError::Deviation(deviation));
        }
        Self { deviation, ..self }.finite()
    }

    /// The car.
    #[must_use]
    pub const fn vehicle(&self) -> &VehicleParameters {
        &self.vehicle
    }

    /// The law.
    #[must_use]
    pub const fn law(&self) -> Law {
        self.law
    }

    /// The distance p, in m.
    #[must_use]
    pub const fn point_distance(&self) -> f64 {
        self.point_distance
    }

    /// The speed of the steady motion, in m/s.
    #[must_use]
    pub const fn speed(&self) -> f64 {
        self.speed
    }

    /// The deviation `dl` of the centre of mass, in m.
    #[must_use]
    pub const fn deviation(&self) -> f64 {
        self.deviation
    }

    /// The range of physically meaningful deviations, from `-l_f` to `l_r`: the
    /// centre of mass is between the axles.
    #[must_use]
    pub const fn meaningful_deviations(vehicle: &VehicleParameters) -> [f64; 2] {
        [-vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m]
    }
}
