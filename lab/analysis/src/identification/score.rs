//! How well a simulation without corrections fits a drive, and prediction errors by channel.

use singletrack_control::words;

use super::{
    data::{Channel, Span},
    fit::Fit,
    simulation::SimulationPoint,
};

words! {
    /// A compared output of the model.
    pub enum Output {
        /// Yaw rate against the gyro.
        YawRate = "yaw_rate",
        /// Sideslip against the cameras.
        Sideslip = "sideslip",
        /// Acceleration to the left against the IMU.
        Left = "left_acceleration",
    }
}

impl Output {
    /// The measured and the simulated value.
    pub const fn of(self, point: &SimulationPoint) -> [f64; 2] {
        match self {
            Self::YawRate => [point.measured_yaw_rate_rad_s, point.yaw_rate_rad_s],
            Self::Sideslip => [point.measured_sideslip_rad, point.sideslip_rad],
            Self::Left => [point.measured_left_m_s2, point.left_m_s2],
        }
    }
}

/// How well an output fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputScore {
    /// The output.
    pub output: Output,
    /// Mean of |model - measured| over the standard deviation of the measured values.
    pub nmpe: f64,
    /// 100 (1 - |model - measured| / |measured - mean|) with norms over the drive: 100 is
    /// perfect, 0 is no better than the mean.
    pub fit_percent: f64,
    /// Root mean square of model - measured, in the output's unit.
    pub rms: f64,
}

/// How well the model fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// The normalised mean prediction error: the mean over the outputs that are measured.
    pub nmpe: f64,
    /// The score of each output; NaN of one that is not measured.
    pub outputs: [OutputScore; 3],
}

impl Score {
    pub(super) fn of(simulation: &[SimulationPoint]) -> Self {
        let all = Span {
            start_s: f64::NEG_INFINITY,
            end_s: f64::INFINITY,
        };
        Self::within(simulation, all)
    }

    /// The score of a part of a simulation.
    pub fn within(simulation: &[SimulationPoint], span: Span) -> Self {
        let outputs = Output::ALL.map(|output| {
            let points = simulation.iter();
            let points = points.filter(|point| span.contains(point.time_s));
            let pairs = points.map(|point| output.of(point));
            let pairs: Vec<_> = pairs
                .filter(|[measured, model]| measured.is_finite() && model.is_finite())
                .collect();
            // Without a pair, all are not a number.
            let count = pairs.len() as f64;
            let mean = pairs.iter().map(|[measured, _]| measured).sum::<f64>() / count;
            let spread: f64 = pairs.iter().map(|[y, _]| (y - mean) * (y - mean)).sum();
            let errors = pairs.iter().map(|[y, model]| model - y);
            let squares: f64 = errors.map(|error| error * error).sum();
            let absolute: f64 = pairs.iter().map(|[y, model]| (model - y).abs()).sum();
            OutputScore {
                output,
                nmpe: absolute / count / (spread / count).sqrt(),
                fit_percent: 100.0 * (1.0 - (squares / spread).sqrt()),
                rms: (squares / count).sqrt(),
            }
        });
        let measured = outputs.iter().filter(|output| !output.rms.is_nan());
        let nmpe: f64 = measured.clone().map(|output| output.nmpe).sum();
        Self {
            nmpe: nmpe / measured.count() as f64,
            outputs,
        }
    }
}

/// The prediction errors of a channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// The channel.
    pub channel: Channel,
    /// Time of each error, in s.
    pub times_s: Vec<f64>,
    /// Each error over its predicted standard deviation.
    pub values: Vec<f64>,
    /// Autocorrelation at lags of one sample and more.
    pub autocorrelation: Vec<f64>,
}

/// Number of lags of the autocorrelation.
const LAGS: usize = 20;

/// The prediction errors of a fit, by channel.
pub(super) fn residuals(fit: &Fit) -> Vec<Residuals> {
    let residuals = Channel::ALL.map(|channel| {
        let of_channel = fit.run.innovations.iter();
        let of_channel = of_channel.filter(|innovation| innovation.channel == channel);
        let (times_s, values): (Vec<f64>, Vec<f64>) = of_channel
            .map(|one| (one.time_s, one.value / one.variance.sqrt()))
            .unzip();
        Residuals {
            channel,
            autocorrelation: autocorrelation(&values),
            times_s,
            values,
        }
    });
    residuals.into()
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
