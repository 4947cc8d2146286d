//! What a reproduction runs with, its extremes, and why it fails.

use std::path::PathBuf;

use singletrack_control::VehicleParameters;
use singletrack_figures::output::WriteError;

use crate::vehicle_file::VehicleFileError;

/// The largest, or not a number.
pub(super) fn largest(values: impl Iterator<Item = f64>) -> f64 {
    extreme(values, f64::max)
}

/// The least, or not a number.
pub(super) fn least(values: impl Iterator<Item = f64>) -> f64 {
    extreme(values, f64::min)
}

fn extreme(values: impl Iterator<Item = f64>, of: fn(f64, f64) -> f64) -> f64 {
    values
        .reduce(|extreme, value| {
            if extreme.is_nan() || value.is_nan() {
                f64::NAN
            } else {
                of(extreme, value)
            }
        })
        .unwrap_or(f64::NAN)
}

/// Why a reproduction failed.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// The car can't be used.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// The catalogue of the claims can't be read.
    #[error("the catalogue of the claims: {0}")]
    Catalogue(#[from] toml::de::Error),
    /// A file or folder can't be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The folder holds files that this command did not write.
    #[error(
        "{} holds files that are not of an earlier reproduction ({found}); choose another folder \
         with --out",
        path.display()
    )]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// The first of these files.
        found: String,
    },
    /// A claim's verdict is not the expected one.
    #[error(
        "{count} of the claims have another verdict than expected: see the lines marked with ! and {}",
        report.display()
    )]
    Surprise {
        /// The number of such claims.
        count: usize,
        /// The report.
        report: PathBuf,
    },
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_and_what_is_not_a_number_have_no_extremes() {
        assert_eq!(largest([1.0, -3.0, 2.0].into_iter()), 2.0);
        assert_eq!(least([1.0, -3.0, 2.0].into_iter()), -3.0);
        for values in [
            &[][..],
            &[f64::NAN, 1.0],
            &[1.0, f64::NAN],
            &[1.0, f64::NAN, 2.0],
        ] {
            assert!(largest(values.iter().copied()).is_nan(), "{values:?}");
            assert!(least(values.iter().copied()).is_nan(), "{values:?}");
        }
    }
}
