//! The car of the reproduction, and lengths in proportion to it.

use singletrack_control::VehicleParameters;

/// Wheelbase of the paper's car, in m, for which its experiments are sized.
const PAPER_WHEELBASE_M: f64 = 0.26;

/// The car of the reproduction, and its thoroughness.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The car.
    pub vehicle: VehicleParameters,
    /// Its name.
    pub name: String,
    /// Coarser maps, shorter drives and fewer seeds.
    pub quick: bool,
}

impl Setup {
    /// Whether the paper's numbers hold for this car.
    #[must_use]
    pub fn is_paper(&self) -> bool {
        self.vehicle == VehicleParameters::paper()
    }

    /// The car's size in units of the paper's: another car drives the paper's
    /// experiments on a floor that is larger by this, in the same time.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.vehicle.wheelbase_m() / PAPER_WHEELBASE_M
    }

    /// Whether the simulated car can represent it: actuators, limits and hall are those
    /// of a car of the paper's kind.
    #[must_use]
    pub fn fits_simulated_car(&self) -> bool {
        (0.5..=2.0).contains(&self.scale())
    }

    /// The distance p of P from the front axle: 0.35 m on the paper's car.
    #[must_use]
    pub fn point_distance_m(&self) -> f64 {
        0.35 * self.scale()
    }

    /// The radius of the circle: 1 m for the paper's car.
    #[must_use]
    pub fn radius_m(&self) -> f64 {
        self.scale()
    }

    /// The deviation dl of the paper's second open-loop test: the law's centre of mass is
    /// at the rear axle.
    #[must_use]
    pub const fn rear_deviation_m(&self) -> f64 {
        self.vehicle.rear_axle_distance_m
    }
}

/// Angular velocity of the circle's reference, in rad/s.
pub(super) const TURN_RATE: f64 = 0.5;
/// Gain of the position loop, per second.
pub(super) const GAIN: f64 = 1.0;
