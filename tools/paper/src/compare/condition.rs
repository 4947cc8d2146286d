//! What is different from a calibrated car with good cameras.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

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
    /// The distance of the front axle from the centre of mass is believed to be 50 mm less.
    #[value(name = "axle-50mm")]
    #[serde(rename = "axle-50mm")]
    AxleLess,
    /// The distance of the front axle from the centre of mass is believed to be 50 mm more.
    #[value(name = "axle+50mm")]
    #[serde(rename = "axle+50mm")]
    AxleMore,
    /// The cameras see nothing for 200 ms, a second after the counting begins.
    #[value(name = "loss-200ms")]
    #[serde(rename = "loss-200ms")]
    Loss,
}

impl Condition {
    /// All, in the order of the table.
    pub const ALL: [Self; 6] = [
        Self::Nominal,
        Self::SoftTyres,
        Self::StiffTyres,
        Self::AxleLess,
        Self::AxleMore,
        Self::Loss,
    ];

    /// As in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::SoftTyres => "tyres-50%",
            Self::StiffTyres => "tyres+50%",
            Self::AxleLess => "axle-50mm",
            Self::AxleMore => "axle+50mm",
            Self::Loss => "loss-200ms",
        }
    }

    /// Factor of the true cornering stiffnesses.
    pub(super) const fn stiffness(self) -> f64 {
        match self {
            Self::SoftTyres => 0.5,
            Self::StiffTyres => 1.5,
            _ => 1.0,
        }
    }

    /// Error of the believed distance of the front axle, in m.
    pub(super) const fn axle_error_m(self) -> f64 {
        match self {
            Self::AxleLess => -0.05,
            Self::AxleMore => 0.05,
            _ => 0.0,
        }
    }

    /// How long the cameras see nothing, in µs.
    pub(super) const fn loss_us(self) -> u64 {
        match self {
            Self::Loss => 200_000,
            _ => 0,
        }
    }
}
