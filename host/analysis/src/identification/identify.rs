//! The identification itself: data and settings in, estimates and their quality out.

use nalgebra::DMatrix;
use singletrack_control::VehicleParameters;

use super::{
    data::{DriveData, ServoFrames, Span},
    error::IdentificationError,
    estimate::{self, Estimate},
    filter::TrackPoint,
    fit::Task,
    model,
    noise::NoiseLevels,
    parameter::{Parameter, Values},
    residuals::{self, Residuals},
    score::Score,
    settings::Settings,
    simulation::{self, Simulation},
    warning::{self, Warning},
};

/// A shorter drive is refused, in s.
pub const LEAST_SECONDS: f64 = 5.0;

/// What a drive says of a car.
#[derive(Clone, Debug)]
pub struct Identification {
    /// What was estimated, in the order asked for.
    pub estimates: Vec<Estimate>,
    /// Correlations of the estimates, in the same order.
    pub correlation: DMatrix<f64>,
    /// All values, estimated or not.
    pub values: Values,
    /// The noise levels.
    pub noise: NoiseLevels,
    /// Which records of the board begin a servo pulse.
    pub frames: ServoFrames,
    /// What of the drive was used.
    pub stretches: Vec<Span>,
    /// What is believed of the car's motion.
    pub track: Vec<TrackPoint>,
    /// The prediction errors.
    pub residuals: Vec<Residuals>,
    /// The model left alone, beside the drive.
    pub simulation: Simulation,
    /// How well that fits.
    pub score: Score,
    /// What should be known of the estimates.
    pub warnings: Vec<Warning>,
    /// How often the drive was predicted.
    pub evaluations: usize,
}

impl Identification {
    /// The vehicle with the estimates.
    #[must_use]
    pub const fn vehicle(&self) -> VehicleParameters {
        self.values.vehicle()
    }

    /// The estimate of a parameter, if it was estimated.
    #[must_use]
    pub fn estimate(&self, parameter: Parameter) -> Option<&Estimate> {
        let mut all = self.estimates.iter();
        all.find(|estimate| estimate.parameter == parameter)
    }

    /// How much of the drive was used, in s.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.stretches.iter().map(Span::seconds).sum()
    }
}

/// Identifies the parameters of a vehicle from a drive, starting from what is
/// believed of it; its mass, its wheelbase and what is not asked for are kept.
///
/// # Errors
///
/// A drive that tells nothing, or from which the fit does not find a car.
pub fn identify(
    data: &DriveData,
    vehicle: &VehicleParameters,
    settings: &Settings,
) -> Result<Identification, IdentificationError> {
    identify_from(data, &Values::of(vehicle), settings)
}

/// The same from values of all parameters.
///
/// # Errors
///
/// As [`identify`].
pub fn identify_from(
    data: &DriveData,
    start: &Values,
    settings: &Settings,
) -> Result<Identification, IdentificationError> {
    if settings.parameters.is_empty() {
        return Err(IdentificationError::NoParameter);
    }
    let stretches = usable(data, settings)?;
    let task = Task {
        data,
        spans: &stretches,
        start: *start,
        active: &settings.parameters,
        settings,
    };
    let fit = task.fit()?;
    let simulation = simulation::simulate(
        data,
        &fit.frames.of(&data.servo),
        &stretches,
        &fit.values,
        settings.tyres,
        &fit.passage.track,
    )
    .ok_or(IdentificationError::Diverged {
        vehicle: fit.values.vehicle(),
    })?;
    let estimates = estimate::estimates(start, settings, &fit);
    let residuals = residuals::residuals(&fit);
    let correlation = estimate::correlation(&fit);
    let mut warnings = warning::of_fit(&fit, settings.tyres);
    warnings.extend(warning::warnings(
        &estimates,
        |row, column| correlation[(row, column)],
        &residuals,
        &stretches,
        &fit.passage.track,
    ));
    Ok(Identification {
        correlation,
        estimates,
        values: fit.values,
        noise: fit.noise,
        frames: fit.frames,
        score: Score::of(&simulation),
        simulation,
        residuals,
        warnings,
        stretches,
        track: fit.passage.track,
        evaluations: fit.evaluations,
    })
}

/// How well an identified car predicts another drive: of that only what belongs to
/// a drive, [`Parameter::OF_A_DRIVE`], is estimated anew.
///
/// # Errors
///
/// As [`identify`].
pub fn validate(
    data: &DriveData,
    identified: &Identification,
    settings: &Settings,
) -> Result<Identification, IdentificationError> {
    let settings = Settings {
        parameters: Parameter::OF_A_DRIVE.to_vec(),
        noise: identified.noise,
        estimate_noise: false,
        frames: None,
        ..settings.clone()
    };
    identify_from(data, &identified.values, &settings)
}

/// The standard deviations that no unbiased estimate from this drive can go below
/// (Cramér and Rao), for a car with `truth` and sensors with `noise`, in the order
/// of the parameters in `settings`.
///
/// # Errors
///
/// As [`identify`], and if the drive does not tell one of the parameters at all.
pub fn cramer_rao(
    data: &DriveData,
    truth: &Values,
    noise: &NoiseLevels,
    frames: ServoFrames,
    settings: &Settings,
) -> Result<Vec<f64>, IdentificationError> {
    let stretches = usable(data, settings)?;
    let task = Task {
        data,
        spans: &stretches,
        start: *truth,
        active: &settings.parameters,
        settings,
    };
    task.bounds(frames, noise)
}

fn usable(data: &DriveData, settings: &Settings) -> Result<Vec<Span>, IdentificationError> {
    data.validate()?;
    let least_speed = settings.least_speed.max(1.5 * model::LEAST_SPEED);
    let stretches = data.stretches(least_speed);
    let seconds: f64 = stretches.iter().map(Span::seconds).sum();
    if seconds >= LEAST_SECONDS {
        return Ok(stretches);
    }
    // What is slow at the start and at the end makes no drive short.
    let fastest = data.fastest();
    Err(if fastest < 1.2 * least_speed {
        IdentificationError::TooSlow {
            fastest,
            least: least_speed,
        }
    } else {
        IdentificationError::TooShort {
            seconds,
            least: LEAST_SECONDS,
            least_speed,
        }
    })
}
