//! What is analysed, and why an analysis fails.

use std::io;

use singletrack_analysis::stability::{
    Belief, ClosedLoop, HopfPoint, Law, SamplingError, StabilityError, hopf_points,
};
use singletrack_control::VehicleParameters;
use singletrack_figures::figure::GridError;

use super::grid::Grid;
use crate::vehicle_file::VehicleFileError;

/// Why a stability study failed.
#[derive(Debug, thiserror::Error)]
pub enum StabilityCommandError {
    /// The vehicle file is invalid.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// There is no steady motion.
    #[error(transparent)]
    Stability(#[from] StabilityError),
    /// The timing is invalid.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// There is nothing to draw a map of.
    #[error("can't draw this: {0}")]
    Grid(#[from] GridError),
    /// The result can't be written.
    #[error("can't write the result: {0}")]
    Write(#[from] io::Error),
}

/// A car, its P and its law.
#[derive(Clone, Copy, Debug)]
pub struct Subject {
    /// The car.
    pub vehicle: VehicleParameters,
    /// The law.
    pub law: Law,
    /// The parameter of the law that is wrong by the deviation.
    pub belief: Belief,
    /// The distance p, in m.
    pub point_distance: f64,
}

impl Subject {
    /// Its steady motion at a speed (m/s), with the law's centre of mass `deviation`
    /// (m) behind the true one.
    ///
    /// # Errors
    ///
    /// Parameters without a steady motion.
    pub fn at(&self, speed: f64, deviation: f64) -> Result<ClosedLoop, StabilityError> {
        Ok(ClosedLoop::new(
            self.vehicle,
            self.law,
            self.point_distance,
            speed,
            deviation,
        )?
        .believing(self.belief))
    }

    /// Its Hopf points at a speed (m/s), over all deviations.
    ///
    /// # Errors
    ///
    /// Parameters without a steady motion.
    pub fn hopf_points(&self, speed: f64) -> Result<Vec<HopfPoint>, StabilityError> {
        hopf_points(
            self.vehicle,
            self.law,
            self.belief,
            self.point_distance,
            speed,
        )
    }

    /// The deviations of the paper: all meaningful ones, and for the
    /// front-point law as far down as its bifurcations lie.
    #[must_use]
    pub fn usual_deviations(&self) -> Grid {
        let [from, to] = ClosedLoop::meaningful_deviations(&self.vehicle);
        let from = match self.law {
            Law::FrontPoint => {
                -(self.vehicle.wheelbase_m() + self.point_distance) - 0.3 * from.abs()
            }
            Law::VelocityPoint => from,
        };
        Grid::spanning([from, to], 121)
    }
}
