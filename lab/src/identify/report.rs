//! The result of an identification.

use std::path::PathBuf;

use singletrack_analysis::identification::{Identification, Score, Tyres};
use singletrack_control::VehicleParameters;

use super::IdentifyError;

/// Drives and their identification.
#[derive(Clone, Debug)]
pub struct Identified {
    /// The drives; at least one.
    pub logs: Vec<LogScore>,
    /// Their result.
    pub identification: Identification,
}

/// How well a drive is simulated.
#[derive(Clone, Debug)]
pub struct LogScore {
    /// The record that it is in.
    pub path: PathBuf,
    /// Its number there, from 1.
    pub drive: usize,
    /// The simulation's score on it.
    pub score: Score,
}

/// The result of the command.
#[derive(Debug)]
pub struct Report {
    /// The nominal car.
    pub vehicle: VehicleParameters,
    /// The tyres' force curve.
    pub tyres: Tyres,
    /// From the records.
    pub identified: Identified,
    /// Validation, drive by drive.
    pub validated: Vec<Identified>,
    /// Why there is no validation on the others.
    pub not_validated: Vec<IdentifyError>,
}

impl Report {
    /// Every drive with its role.
    pub(super) fn logs(&self) -> impl Iterator<Item = (&'static str, &LogScore)> {
        let identified = self.identified.logs.iter();
        let validated = self.validated.iter().flat_map(|one| &one.logs);
        let identified = identified.map(|log| ("identification", log));
        identified.chain(validated.map(|log| ("validation", log)))
    }
}
