//! Identification of the car's parameters from a drive.
//!
//! Cornering stiffnesses, yaw inertia and whatever else is asked for are those with
//! which the drive is predicted best: the model of the paper (equation 1), with tyres
//! that slide and a servo that lags, is driven by what the servo was told and by the
//! acceleration forward; a Kalman filter predicts each pose and each inertial sample
//! from those before it; and the sum of the squares of the prediction errors, each over
//! the standard deviation that it should have, is minimised. Unlike the errors of a
//! simulation, these are white if the model is right, so that the inverse of the
//! information is the estimates' covariance; a second covariance holds for errors
//! that are coloured over up to half a second, and the wider of the two is told.
//!
//! What a drive does not tell otherwise is estimated along: lag, delay and trim of the
//! steering, the delay and the biases of the IMU, and the levels of all noise, by
//! their likelihood.

mod data;
mod filter;
mod fit;
mod model;
mod noise;
mod parameter;
mod predictor;
mod score;
mod simulation;
mod timeline;
mod uncertainty;
mod warning;

pub use data::{DriveData, Inertial, Pose, ServoFrames, ServoTarget, Span};
pub use filter::{Channel, TrackPoint};
pub use noise::NoiseLevels;
pub use parameter::{Parameter, UnknownParameter, Values};
pub use score::{Output, OutputScore, Score};
pub use simulation::{Simulation, SimulationPoint};
pub use singletrack_control::Tyres;
pub use warning::Warning;

use fit::{Fit, Task};
use nalgebra::DMatrix;
use singletrack_control::VehicleParameters;

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

/// A shorter drive is refused, in s.
pub const LEAST_SECONDS: f64 = 5.0;

/// Why nothing is identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentificationError {
    /// A list is as good as empty.
    #[error("there are {count} {what} in the drive: record one with motion capture and board")]
    TooFew {
        /// What there is too little of.
        what: &'static str,
        /// How many there are.
        count: usize,
    },
    /// A number that is none.
    #[error("number {index} of the {what} is not finite: the record is damaged there")]
    NotFinite {
        /// In which list.
        what: &'static str,
        /// Its index, from 0.
        index: usize,
    },
    /// Time goes back.
    #[error("number {index} of the {what}, at {time_s} s, is older than the one before it")]
    OutOfOrder {
        /// In which list.
        what: &'static str,
        /// Its index, from 0.
        index: usize,
        /// Its time, in s.
        time_s: f64,
    },
    /// The car hardly moved.
    #[error(
        "the car was never faster than {fastest:.2} m/s for long, and only what is faster than \
         {least:.2} m/s can be used: drive faster, 1.5 m/s or more"
    )]
    TooSlow {
        /// Its fastest, in m/s.
        fastest: f64,
        /// What counts, in m/s.
        least: f64,
    },
    /// Too little of the drive can be used.
    #[error(
        "only {seconds:.1} s of the drive are faster than {least_speed:.2} m/s with poses and \
         inertial samples throughout, {least:.0} s are needed: drive longer, a minute is good"
    )]
    TooShort {
        /// What can be used, in s.
        seconds: f64,
        /// What is needed, in s.
        least: f64,
        /// What counts, in m/s.
        least_speed: f64,
    },
    /// Nothing is asked for.
    #[error("no parameter is to be estimated: name some, such as c_f,c_r,i_z")]
    NoParameter,
    /// The fit went where no car is.
    #[error(
        "the fit does not converge; it was last at C_f {:.3} N/rad, C_r {:.3} N/rad, I_z {:.5} kg m²: \
         start from a vehicle that is closer (--vehicle), and check mass, wheelbase and the servo's \
         calibration",
        .vehicle.front_cornering_stiffness_n_rad,
        .vehicle.rear_cornering_stiffness_n_rad,
        .vehicle.yaw_inertia_kg_m2
    )]
    Diverged {
        /// Where it was.
        vehicle: VehicleParameters,
    },
}

/// An estimated parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Which.
    pub parameter: Parameter,
    /// Where the fit started, in the parameter's unit.
    pub start: f64,
    /// The estimate.
    pub value: f64,
    /// Its standard deviation.
    pub standard_deviation: f64,
    /// In which it lies with 95 %.
    pub interval: [f64; 2],
    /// Standard deviation if the prediction errors are white.
    pub white_deviation: f64,
    /// Standard deviation whatever their colour within half a second.
    pub robust_deviation: f64,
    /// Whether it has run as far as it may.
    pub at_bound: bool,
}

/// The prediction errors of a channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// Of what.
    pub channel: Channel,
    /// When each was, in s.
    pub times_s: Vec<f64>,
    /// Each, over the standard deviation that it should have.
    pub values: Vec<f64>,
    /// Their autocorrelation at lags from one sample on.
    pub autocorrelation: Vec<f64>,
}

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
    let estimates = estimates(start, settings, &fit);
    let residuals = residuals(&fit);
    let correlation = correlation(&fit);
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

/// Standard deviations to either side within which 95 % lie.
const NINETY_FIVE: f64 = 1.96;

fn estimates(start: &Values, settings: &Settings, fit: &Fit) -> Vec<Estimate> {
    let active = settings.parameters.iter().zip(&fit.u);
    active
        .enumerate()
        .map(|(index, (parameter, u))| {
            let prior = parameter.prior();
            let start = start.get(*parameter);
            let slope = prior.slope(start, *u).abs();
            let spread = &fit.spread;
            let deviation = spread.deviations.get(index).copied().unwrap_or(f64::NAN);
            let reach = NINETY_FIVE * deviation;
            Estimate {
                parameter: *parameter,
                start,
                value: prior.value(start, *u),
                standard_deviation: slope * deviation,
                interval: [u - reach, u + reach].map(|u| prior.value(start, u)),
                white_deviation: slope * spread.white[(index, index)].sqrt(),
                robust_deviation: slope * spread.robust[(index, index)].sqrt(),
                at_bound: parameter::Prior::is_at_bound(*u),
            }
        })
        .collect()
}

fn correlation(fit: &Fit) -> DMatrix<f64> {
    let white = &fit.spread.white;
    DMatrix::from_fn(white.nrows(), white.ncols(), |row, column| {
        white[(row, column)] / (white[(row, row)] * white[(column, column)]).sqrt()
    })
}

/// How many lags of the autocorrelation are told.
const LAGS: usize = 20;

fn residuals(fit: &Fit) -> Vec<Residuals> {
    Channel::ALL
        .into_iter()
        .map(|channel| {
            let of_channel = fit.passage.innovations.iter();
            let of_channel = of_channel.filter(|innovation| innovation.channel == channel);
            let (times_s, values): (Vec<f64>, Vec<f64>) = of_channel
                .map(|innovation| {
                    (
                        innovation.time_s,
                        innovation.value / innovation.variance.sqrt(),
                    )
                })
                .unzip();
            Residuals {
                channel,
                autocorrelation: autocorrelation(&values),
                times_s,
                values,
            }
        })
        .collect()
}

fn autocorrelation(values: &[f64]) -> Vec<f64> {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let product = |lag: usize| -> f64 {
        let later = values.iter().skip(lag);
        values
            .iter()
            .zip(later)
            .map(|(one, other)| (one - mean) * (other - mean))
            .sum()
    };
    let all = product(0);
    (1..=LAGS.min(values.len().saturating_sub(1)))
        .map(|lag| if all > 0.0 { product(lag) / all } else { 0.0 })
        .collect()
}
