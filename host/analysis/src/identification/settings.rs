//! The choices of an identification.

use singletrack_control::Tyres;

use super::{data::ServoFrames, noise::NoiseLevels, parameter::Parameter};

/// What is estimated, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// What is estimated. What of [`Parameter::NUISANCE`] is not in it stays where
    /// it starts.
    pub parameters: Vec<Parameter>,
    /// The tyres' force curve.
    pub tyres: Tyres,
    /// Which records of the board begin a servo pulse; none to find out.
    pub frames: Option<ServoFrames>,
    /// Noise levels: where their estimation starts.
    pub noise: NoiseLevels,
    /// Whether the noise levels are estimated.
    pub estimate_noise: bool,
    /// Slower than this nothing is used, in m/s: there the tyres hardly slip.
    pub least_speed: f64,
}

impl Default for Settings {
    /// The paper's three parameters with all that has to be estimated along.
    fn default() -> Self {
        Self::of(&Parameter::VEHICLE)
    }
}

impl Settings {
    /// These parameters with all that has to be estimated along.
    #[must_use]
    pub fn of(parameters: &[Parameter]) -> Self {
        let mut all = Vec::new();
        for parameter in parameters.iter().chain(&Parameter::NUISANCE) {
            if !all.contains(parameter) {
                all.push(*parameter);
            }
        }
        Self {
            parameters: all,
            tyres: Tyres::default(),
            frames: None,
            noise: NoiseLevels::usual(),
            estimate_noise: true,
            least_speed: 0.5,
        }
    }
}
