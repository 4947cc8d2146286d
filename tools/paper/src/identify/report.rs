//! The result of an identification.

use std::path::PathBuf;

use singletrack_analysis::identification::{Identification, Tyres};
use singletrack_control::VehicleParameters;

/// A drive and its identification.
#[derive(Clone, Debug)]
pub struct Identified {
    /// The record that it is in.
    pub path: PathBuf,
    /// Its number there, from 1.
    pub drive: usize,
    /// Its result.
    pub identification: Identification,
}

/// The result of the command.
#[derive(Clone, Debug)]
pub struct Report {
    /// The nominal car.
    pub vehicle: VehicleParameters,
    /// The tyres' force curve.
    pub tyres: Tyres,
    /// From the first record.
    pub identified: Identified,
    /// Validation on the second.
    pub validated: Option<Identified>,
}
