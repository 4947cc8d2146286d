//! What is different from a calibrated car with good cameras.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use singletrack_control::VehicleParameters;

use super::name_of;

/// A condition of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The car is as it is believed to be.
    Nominal,
    /// The true tyres have half the cornering stiffness.
    #[value(name = "tyres-50%")]
    #[serde(rename = "tyres-50%")]
    SoftTyres,
    /// The true tyres have 1.5 times the cornering stiffness.
    #[value(name = "tyres+50%")]
    #[serde(rename = "tyres+50%")]
    StiffTyres,
    /// The front axle is believed to be at the centre of mass: dl = `-l_f`.
    #[value(name = "axle-lf")]
    #[serde(rename = "axle-lf")]
    AxleLeast,
    /// The distance of the front axle from the centre of mass is believed to be 50 mm less.
    #[value(name = "axle-50mm")]
    #[serde(rename = "axle-50mm")]
    AxleLess,
    /// The distance of the front axle from the centre of mass is believed to be 50 mm more.
    #[value(name = "axle+50mm")]
    #[serde(rename = "axle+50mm")]
    AxleMore,
    /// The rear axle is believed to be at the centre of mass: dl = `l_r`.
    #[value(name = "axle+lr")]
    #[serde(rename = "axle+lr")]
    AxleMost,
    /// The cameras see nothing for 50 ms, a second after the counting begins.
    #[value(name = "loss-50ms")]
    #[serde(rename = "loss-50ms")]
    Loss50,
    /// The same for 100 ms.
    #[value(name = "loss-100ms")]
    #[serde(rename = "loss-100ms")]
    Loss100,
    /// The same for 200 ms.
    #[value(name = "loss-200ms")]
    #[serde(rename = "loss-200ms")]
    Loss200,
    /// The same for 500 ms.
    #[value(name = "loss-500ms")]
    #[serde(rename = "loss-500ms")]
    Loss500,
    /// The same for a second.
    #[value(name = "loss-1000ms")]
    #[serde(rename = "loss-1000ms")]
    Loss1000,
    /// The paper's equations in place of the simulated car: no lag, noise, limits or estimator.
    IdealPlant,
    /// The search for the least added delay that diverges, in a table of its own.
    AddedDelay,
}

impl Condition {
    /// As in the table.
    #[must_use]
    pub fn name(self) -> String {
        name_of(&self)
    }

    /// Factor of the true cornering stiffnesses.
    pub(super) const fn stiffness(self) -> f64 {
        match self {
            Self::SoftTyres => 0.5,
            Self::StiffTyres => 1.5,
            _ => 1.0,
        }
    }

    /// Error of the believed distance of the front axle, in m: dl.
    pub(super) fn axle_error_m(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::AxleLeast => -vehicle.front_axle_distance_m,
            Self::AxleLess => -0.05,
            Self::AxleMore => 0.05,
            Self::AxleMost => vehicle.rear_axle_distance_m,
            _ => 0.0,
        }
    }

    /// How long the cameras see nothing, in µs.
    pub(super) const fn loss_us(self) -> u64 {
        match self {
            Self::Loss50 => 50_000,
            Self::Loss100 => 100_000,
            Self::Loss200 => 200_000,
            Self::Loss500 => 500_000,
            Self::Loss1000 => 1_000_000,
            _ => 0,
        }
    }
}

use Condition::{AxleLeast, AxleLess, AxleMore, AxleMost, Nominal, SoftTyres, StiffTyres};

/// Conditions of which the worst has a row of its own, with its name in the table: within 50 % of
/// the cornering stiffness, and over the believed place of the front axle, dl from `-l_f` to
/// `l_r`.
pub(super) const WORST: [(&str, &[Condition]); 2] = [
    ("worst-tyres", &[Nominal, SoftTyres, StiffTyres]),
    (
        "worst-axle",
        &[Nominal, AxleLeast, AxleLess, AxleMore, AxleMost],
    ),
];
