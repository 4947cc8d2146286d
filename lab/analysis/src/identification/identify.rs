//! Identification of a drive, validation on another, and the Cramér-Rao bound.

use nalgebra::DMatrix;
use singletrack_control::VehicleParameters;

use super::{
    data::{Channel, DriveData, ServoFrames, Span},
    error::{IdentificationError, Result},
    estimate::{self, Estimate},
    filter::TrackPoint,
    fit::{Fit, Task},
    model,
    noise::NoiseLevels,
    parameter::{Parameter, Values},
    plausibility,
    problem::{Criterion, Settings},
    score::{self, Residuals, Score},
    simulation::{self, Inputs, SimulationPoint},
    warning::{self, Warning},
};

/// The smallest usable duration of a drive, in s.
const LEAST_SECONDS: f64 = 5.0;

/// The result of an identification.
#[derive(Clone, Debug)]
pub struct Identification {
    /// The estimates, in the order of the settings.
    pub estimates: Vec<Estimate>,
    /// Correlations of the estimates, in the same order.
    pub correlation: DMatrix<f64>,
    /// The values of all parameters, estimated or not.
    pub values: Values,
    /// What was minimised.
    pub criterion: Criterion,
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
    pub simulation: Vec<SimulationPoint>,
    /// How well the simulation fits.
    pub score: Score,
    /// Reasons to doubt the estimates.
    pub warnings: Vec<Warning>,
}

impl Identification {
    /// The vehicle with the estimates.
    pub const fn vehicle(&self) -> VehicleParameters {
        self.values.vehicle()
    }

    /// Another car with the steering of this one, to be [validated](validate) beside it.
    pub fn with_vehicle(&self, vehicle: &VehicleParameters) -> Self {
        let steering = [
            Parameter::ServoLag,
            Parameter::SteeringDelay,
            Parameter::SteeringTrim,
            Parameter::GyroScale,
        ];
        let values = steering
            .into_iter()
            .fold(Values::of(vehicle), |values, parameter| {
                values.with(parameter, self.values.get(parameter))
            });
        Self {
            values,
            ..self.clone()
        }
    }

    /// The estimate of a parameter; none if it was not estimated.
    pub fn estimate(&self, parameter: Parameter) -> Option<&Estimate> {
        let mut all = self.estimates.iter();
        all.find(|estimate| estimate.parameter == parameter)
    }

    /// Duration of the stretches that were used, in s.
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
) -> Result<Identification> {
    let mut start = Values::of(vehicle);
    if let Some([delay, lag]) = settings.steering {
        start = start
            .with(Parameter::SteeringDelay, delay)
            .with(Parameter::ServoLag, lag);
    }
    identified(data, &start, settings, check)
}

/// Identifies, and refuses what `check` refuses.
fn identified(
    data: &DriveData,
    start: &Values,
    settings: &Settings,
    check: impl Fn(&Fit, &[Estimate]) -> Result<()>,
) -> Result<Identification> {
    if settings.parameters.is_empty() {
        return Err(IdentificationError::NoParameter);
    }
    // What belongs to a sensor that the car does not have is no parameter of the drive.
    let [gyro, accelerometer] =
        [Channel::YawRate, Channel::Left].map(|channel| data.measures(channel));
    let mut settings = settings.clone();
    settings.parameters.retain(|parameter| match parameter {
        Parameter::GyroScale => gyro,
        Parameter::LateralBias => accelerometer,
        Parameter::InertialDelay => gyro || accelerometer,
        _ => true,
    });
    let settings = &settings;
    let stretches = usable(data, settings)?;
    let fused = fused(data, settings, &stretches);
    let (data, settings) = (&fused.0, &fused.1);
    let task = Task {
        data,
        spans: &stretches,
        start: *start,
        settings,
    };
    let Chosen {
        fit,
        simulation,
        criterion,
        warning,
    } = choose(&task)?;
    let estimates = estimate::estimates(start, settings, &fit);
    check(&fit, &estimates)?;
    let correlation = estimate::correlation(&fit);
    let residuals = score::residuals(&fit);
    // Those of the filter that only follows the sensors say nothing of the model.
    let told = match criterion {
        Criterion::Prediction => &residuals[..],
        Criterion::Simulation => &[],
    };
    let mut warnings: Vec<Warning> = warning.into_iter().collect();
    warnings.extend(warning::of_fit(&fit, settings.tyres, criterion));
    warnings.extend(warning::warnings(
        &estimates,
        &correlation,
        told,
        &stretches,
        &fit.run.track,
    ));
    let score = Score::of(&simulation);
    warnings.extend(warning::of_score(&score));
    Ok(Identification {
        correlation,
        estimates,
        values: fit.values,
        criterion,
        noise: fit.noise,
        frames: fit.frames,
        score,
        simulation,
        residuals,
        warnings,
        stretches,
        track: fit.run.track,
    })
}

/// The data with the forward acceleration of all sensors, and the settings with its noise.
fn fused(data: &DriveData, settings: &Settings, spans: &[Span]) -> (DriveData, Settings) {
    let mut settings = settings.clone();
    let position_m = settings.noise.with_measured_sensors(data, spans).position_m;
    let Some((data, density)) = data.with_fused_acceleration(position_m, spans) else {
        return (data.clone(), settings);
    };
    let noise = &mut settings.noise;
    // One that is given may be that of another drive's fused acceleration, as in a validation.
    noise.forward_density = match settings.estimate_noise {
        true => density,
        false => density.min(noise.forward_density),
    };
    (data, settings)
}

/// A fit with its simulation.
struct Chosen {
    fit: Fit,
    simulation: Vec<SimulationPoint>,
    criterion: Criterion,
    warning: Option<Warning>,
}

impl Chosen {
    fn of(task: &Task<'_>, fit: Fit, criterion: Criterion) -> Result<Self> {
        let servo = fit.frames.of(&task.data.servo);
        let inputs = Inputs {
            drive: task.drive(&servo),
            run: &fit.run,
        };
        let simulation = simulation::simulate(&inputs, &fit.values, task.settings);
        let simulation = simulation.ok_or_else(|| task.diverged(&fit.u))?;
        Ok(Self {
            fit,
            simulation,
            criterion,
            warning: None,
        })
    }

    fn nmpe(&self) -> f64 {
        Score::of(&self.simulation).nmpe
    }
}

/// The simulation's error is minimised instead if that makes it smaller by this share.
const WORTH: f64 = 0.1;

/// The fit by the criterion of the settings, or the better of the two.
fn choose(task: &Task<'_>) -> Result<Chosen> {
    let settings = task.settings;
    let by_prediction = || Chosen::of(task, task.fit()?, Criterion::Prediction);
    let by_simulation = |first: Option<&Fit>| {
        let frames = first.map(|fit| fit.frames).or(settings.frames);
        let noise = first.map(|fit| fit.noise);
        let fit = task.fit_simulation(frames.unwrap_or(ServoFrames::Every), noise)?;
        Chosen::of(task, fit, Criterion::Simulation)
    };
    match settings.criterion {
        Some(Criterion::Prediction) => return by_prediction(),
        Some(Criterion::Simulation) => return by_simulation(None),
        None => {}
    }
    let prediction = by_prediction();
    let right = |one: &Chosen| one.fit.unsettled.is_none() && !warning::is_unexplained(&one.fit);
    if prediction.as_ref().is_ok_and(right) {
        return prediction;
    }
    let fit = prediction.as_ref().ok().map(|one| &one.fit);
    let Ok(simulation) = by_simulation(fit) else {
        return prediction;
    };
    // Where both fail, the prediction says better why.
    if !not_told(&simulation.fit, settings.parameters.iter().copied()).is_empty() {
        return prediction;
    }
    let nmpe = simulation.nmpe();
    let (before, settled) = match &prediction {
        Ok(one) => (Some(one.nmpe()), one.fit.unsettled.is_none()),
        Err(_) => (None, false),
    };
    if settled && before.is_some_and(|before| nmpe > (1.0 - WORTH) * before) {
        return prediction;
    }
    let prediction = before;
    let warning = Some(Warning::Simulated { nmpe, prediction });
    Ok(Chosen {
        warning,
        ..simulation
    })
}

/// A drive says less of a parameter than its start value does above this standard deviation, in those
/// of the prior.
const UNDETERMINED: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// The parameters, of those of a fit and in their order, of which the drive says less than their start
/// values do.
fn not_told(fit: &Fit, parameters: impl Iterator<Item = Parameter>) -> Vec<Parameter> {
    let all = parameters.enumerate();
    let not_told = all.filter(|(index, parameter)| {
        let told = fit.spread.white[(*index, *index)].sqrt() < UNDETERMINED;
        !told && !Parameter::NUISANCE.contains(parameter)
    });
    not_told.map(|(_, parameter)| parameter).collect()
}

/// Refuses what is no answer of the drive.
fn check(fit: &Fit, estimates: &[Estimate]) -> Result<()> {
    if fit.u.iter().all(|u| *u == 0.0) {
        return Err(IdentificationError::NotMoved);
    }
    let parameters = not_told(fit, estimates.iter().map(|estimate| estimate.parameter));
    if !parameters.is_empty() {
        return Err(IdentificationError::NotDetermined(parameters));
    }
    if let Some(moved) = fit.unsettled {
        return Err(IdentificationError::NotSettled(moved));
    }
    estimates
        .iter()
        .find(|estimate| estimate.at_bound)
        .map_or(Ok(()), |estimate| {
            Err(IdentificationError::AtBound {
                parameter: estimate.parameter,
                start: estimate.start,
                value: estimate.value,
            })
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
) -> Result<Identification> {
    let settings = Settings {
        parameters: Parameter::OF_A_DRIVE.to_vec(),
        noise: identified.noise,
        estimate_noise: false,
        // The simulation does not tell which periods begin a pulse.
        frames: settings
            .frames
            .or((identified.criterion == Criterion::Simulation).then_some(identified.frames)),
        criterion: Some(identified.criterion),
        ..settings.clone()
    };
    // The score tells how well they fit.
    self::identified(data, &identified.values, &settings, |_, _| Ok(()))
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
) -> Result<Vec<f64>> {
    let stretches = usable(data, settings)?;
    let task = Task {
        data,
        spans: &stretches,
        start: *truth,
        settings,
    };
    task.bounds(frames, noise)
}

/// The stretches that can be used, if they are long enough.
fn usable(data: &DriveData, settings: &Settings) -> Result<Vec<Span>> {
    data.validate()?;
    plausibility::check_unit(data)?;
    let least_speed = settings.least_speed.max(1.5 * model::LEAST_SPEED);
    let stretches = data.stretches(least_speed);
    let lengths = stretches.iter().map(Span::seconds);
    let seconds = lengths.fold(0.0, |sum, one| sum + one);
    if seconds >= LEAST_SECONDS {
        plausibility::check_sensors(data, &stretches)?;
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
