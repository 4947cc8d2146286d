//! Identification of a drive, validation on another, and the Cramér-Rao bound. Before anything is fitted, the
//! sensors must agree at all: wrong signs, units and mountings are refused.

use nalgebra::DMatrix;
use singletrack_control::VehicleParameters;

use super::{
    data::{
        Channel, DriveData, GyroScale, Inertial, Seen, ServoFrames, Span, are_at, median, seen,
    },
    error::{IdentificationError, Result},
    filter::{Residuals, TrackPoint},
    fit::{self, Estimate, Fit, Task},
    model,
    parameter::{Parameter, Values},
    settings::{Criterion, NoiseLevels, Settings},
    simulation::{self, Score, SimulationPoint},
    warning::{self, Warning},
};

/// The smallest usable duration of a drive, in s.
const LEAST_SECONDS: f64 = 5.0;
/// A car with a faster median speed is not a small car, in m/s: the unit of its positions is wrong.
const FASTEST: f64 = 50.0;
/// The mean cosine of the angle between yaw and course, below which the yaw is not that of the car.
const ALONG: f64 = 0.5;
/// The gyro's scale beyond which its unit or sign is wrong.
const SCALE: core::ops::RangeInclusive<f64> = 0.7..=1.4;
/// The standard deviation of the yaw rate, above which the cameras' noise does not hide it, in rad/s.
const TURNING: f64 = 0.3;
/// The correlation of steering and curvature below which the steering's sign is wrong.
const OPPOSES: f64 = -0.5;

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
    let estimates = fit::estimates(start, settings, &fit);
    check(&fit, &estimates)?;
    let correlation = fit::correlation(&fit);
    let residuals = fit.run.residuals();
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
        let drive = task.drive(&servo);
        let simulation = simulation::simulate(drive, &fit.run, &fit.values, task.settings);
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
    // Positions in another unit than m.
    if let Some(median) = median(data.speeds().collect())
        && median > FASTEST
    {
        return Err(IdentificationError::TooFast(median));
    }
    let least_speed = settings.least_speed.max(1.5 * model::LEAST_SPEED);
    let stretches = data.stretches(least_speed);
    let lengths = stretches.iter().map(Span::seconds);
    let seconds = lengths.fold(0.0, |sum, one| sum + one);
    if seconds >= LEAST_SECONDS {
        check_sensors(data, &stretches)?;
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

/// Whether the sensors agree in the stretches.
fn check_sensors(data: &DriveData, spans: &[Span]) -> Result<()> {
    let within = |time: f64| are_at(spans, time);
    type Value = fn(&Inertial) -> f64;
    let channels: [(&'static str, Value); 3] = [
        ("yaw rate", |sample| sample.yaw_rate_rad_s),
        ("acceleration forward", |sample| sample.forward_m_s2),
        ("acceleration to the left", |sample| sample.left_m_s2),
    ];
    for (what, value) in channels {
        let inertial = data.inertial.iter();
        let mut values = inertial.filter(|sample| within(sample.time_s)).map(value);
        if let Some(first) = values.next()
            && !first.is_nan()
            && values.all(|value| value.to_bits() == first.to_bits())
        {
            return Err(IdentificationError::Dead(what, first));
        }
    }
    let times = data.poses.iter().map(|pose| pose.time_s);
    let moved = times.filter(|time| within(*time));
    let moved: Vec<(f64, Seen)> = moved
        .filter_map(|time| Some((time, seen(&data.poses, time)?)))
        .collect();
    let count = moved.len() as f64;
    let sum = |value: fn(f64) -> f64| {
        let values = moved.iter().map(|(_, seen)| value(seen.sideslip));
        values.sum::<f64>()
    };
    let (sine, cosine) = (sum(f64::sin) / count, sum(f64::cos) / count);
    if cosine < ALONG {
        let off = sine.atan2(cosine);
        return Err(IdentificationError::YawDiffers(off));
    }
    if let Some(scale) = GyroScale::of(data, spans)
        && !SCALE.contains(&scale.value)
        && scale.turning > TURNING
    {
        return Err(IdentificationError::GyroDiffers(scale.value));
    }
    let pairs = moved.iter().filter_map(|(time, seen)| {
        let after = data.servo.partition_point(|target| target.time_s <= *time);
        let target = data.servo.get(after.checked_sub(1)?)?;
        Some([target.angle_rad, seen.yaw_rate / seen.speed])
    });
    let correlation = correlation_of_pairs(&pairs.collect::<Vec<_>>());
    if correlation < OPPOSES {
        return Err(IdentificationError::SteeringOpposes(correlation));
    }
    Ok(())
}

/// The correlation of pairs of numbers; 0 if one of them does not change.
fn correlation_of_pairs(pairs: &[[f64; 2]]) -> f64 {
    let count = pairs.len() as f64;
    let mean = |index: usize| pairs.iter().map(|pair| pair[index]).sum::<f64>() / count;
    let (one, other) = (mean(0), mean(1));
    let sum = |value: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(value).sum::<f64>();
    let product = sum(&|pair| (pair[0] - one) * (pair[1] - other));
    let squares = sum(&|pair| (pair[0] - one).powi(2)) * sum(&|pair| (pair[1] - other).powi(2));
    if squares > 0.0 {
        product / squares.sqrt()
    } else {
        0.0
    }
}
