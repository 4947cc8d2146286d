//! Prediction errors by channel, and their autocorrelation.

use super::{channel::Channel, fit::Fit};

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
    Channel::ALL
        .into_iter()
        .map(|channel| {
            let of_channel = fit.run.innovations.iter();
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
