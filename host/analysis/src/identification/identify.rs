//! Identification of a drive, validation on another, and the Cramér-Rao bound.

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

/// The smallest usable duration of a drive, in s.
pub const LEAST_SECONDS: f64 = 5.0;

/// The result of an identification.
#[derive(Clone, Debug)]
pub struct Identification {
    /// The estimates, in the order of the settings.
    pub estimates: Vec<Estimate>,
    /// Correlations of the estimates, in the same order.
    pub correlation: DMatrix<f64>,
    /// The values of all parameters, estimated or not.
    pub values: Values,
    /// The noise levels.
    pub noise: NoiseLevels,
    /// The board's periods that begin a servo pulse.
    pub frames: ServoFrames,
    /// The stretches of the drive that were used.
    pub stretches: Vec<Span>,
    /// The filter's estimate of the car's motion.
    pub track: Vec<TrackPoint>,
    /// The prediction errors.
    pub residuals: Vec<Residuals>,
    /// A simulation of the model without corrections, with the measurements.
    pub simulation: Simulation,
    /// How well the simulation fits.
    pub score: Score,
    /// Reasons to doubt the estimates.
    pub warnings: Vec<Warning>,
    /// Number of evaluations of the prediction errors.
    pub evaluations: usize,
}

impl Identification {
    /// The vehicle with the estimates.
    #[must_use]
    pub const fn vehicle(&self) -> VehicleParameters {
        self.values.vehicle()
    }

    /// The estimate of a parameter; none if it was not estimated.
    #[must_use]
    pub fn estimate(&self, parameter: Parameter) -> Option<&Estimate> {
        let mut all = self.estimates.iter();
        all.find(|estimate| estimate.parameter == parameter)
    }

    /// Duration of the stretches that were used, in s.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.stretches.iter().map(Span::seconds).sum()
    }
}

/// Identifies the parameters of a vehicle from a drive.
///
/// The fit starts from `vehicle`. Mass, wheelbase and the parameters that the settings do
/// not name keep their values.
///
/// # Errors
///
/// A drive that is damaged, too slow or too short, and a fit that diverges.
pub fn identify(
    data: &DriveData,
    vehicle: &VehicleParameters,
    settings: &Settings,
) -> Result<Identification, IdentificationError> {
    identify_from(data, &Values::of(vehicle), settings)
}

/// Identifies as [`identify`] does, from start values of all parameters.
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
        &fit.run.track,
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
        &fit.run.track,
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
        track: fit.run.track,
        evaluations: fit.evaluations,
    })
}

/// Measures how well an identified car predicts another drive.
///
/// Only the parameters that differ between drives, [`Parameter::OF_A_DRIVE`], are
/// estimated again.
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

/// The smallest standard deviations of unbiased estimates from this drive (the Cramér-Rao
/// bound), for a car with `truth` and sensors with `noise`.
///
/// In the order of the parameters in `settings`.
///
/// # Errors
///
/// As [`identify`], and if the drive does not determine one of the parameters.
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

/// The stretches that can be used, if they are long enough.
fn usable(data: &DriveData, settings: &Settings) -> Result<Vec<Span>, IdentificationError> {
    data.validate()?;
    let least_speed = settings.least_speed.max(1.5 * model::LEAST_SPEED);
    let stretches = data.stretches(least_speed);
    let seconds: f64 = stretches.iter().map(Span::seconds).sum();
    if seconds >= LEAST_SECONDS {
        return Ok(stretches);
    }
    // A drive is slow at its start and end: only the fastest speed shows whether it was
    // too slow or too short.
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
