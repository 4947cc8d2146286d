//! What was identified.

use std::path::PathBuf;

use singletrack_analysis::identification::{Identification, Tyres};
use singletrack_control::VehicleParameters;

/// A drive, and what it says.
#[derive(Clone, Debug)]
pub struct Identified {
    /// The record that it is in.
    pub path: PathBuf,
    /// Its number there, from 1.
    pub drive: usize,
    /// What it says.
    pub identification: Identification,
}

/// Everything that was found.
#[derive(Clone, Debug)]
pub struct Report {
    /// The car as it was believed to be.
    pub vehicle: VehicleParameters,
    /// The tyres' force curve.
    pub tyres: Tyres,
    /// From the first record.
    pub identified: Identified,
    /// How that fits the second.
    pub validated: Option<Identified>,
}
