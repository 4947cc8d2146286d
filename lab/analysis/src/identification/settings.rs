//! The choices of an identification.

use singletrack_control::Tyres;
use singletrack_words::words;

use super::{data::ServoFrames, noise::NoiseLevels, parameter::Parameter};

words! {
    /// What a fit minimises.
    pub enum Criterion {
        /// The errors of the prediction of each sample from those before it: the most exact, if the
        /// model is right.
        Prediction = "prediction",
        /// The errors of the model alone, without a correction since the stretch began: what a
        /// simulation of the car needs, and robust against behaviour that the model lacks.
        Simulation = "simulation",
    }
}

/// The parameters, model and noise levels of an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The parameters to estimate. The others keep their start values, those of
    /// [`Parameter::NUISANCE`] included.
    pub parameters: Vec<Parameter>,
    /// The force curve of the tyres.
    pub tyres: Tyres,
    /// The board's periods that begin a servo pulse; none to estimate them.
    pub frames: Option<ServoFrames>,
    /// Noise levels, or their start values if they are estimated.
    pub noise: NoiseLevels,
    /// Estimates the noise levels too.
    pub estimate_noise: bool,
    /// What is minimised; none for the prediction, and for the simulation where forces that the model does
    /// not explain make the prediction's parameters simulate much worse.
    pub criterion: Option<Criterion>,
    /// The smallest speed that is used, in m/s: at lower speeds the tyres hardly slip.
    pub least_speed: f64,
}

impl Default for Settings {
    /// The paper's three parameters and those that must be estimated jointly with them.
    fn default() -> Self {
        Self::of(&Parameter::VEHICLE)
    }
}

impl Settings {
    /// These parameters and [`Parameter::NUISANCE`], which must be estimated jointly.
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
            criterion: None,
            least_speed: 0.5,
        }
    }
}
