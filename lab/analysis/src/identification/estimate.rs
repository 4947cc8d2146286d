//! Estimated parameters with their confidence intervals.

use nalgebra::DMatrix;

use super::{
    fit::Fit,
    parameter::{self, Parameter, Values},
    problem::Settings,
};

/// An estimated parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The parameter.
    pub parameter: Parameter,
    /// The start value of the fit, in the parameter's unit.
    pub start: f64,
    /// The estimate.
    pub value: f64,
    /// Its standard deviation.
    pub standard_deviation: f64,
    /// The 95 % confidence interval.
    pub interval: [f64; 2],
    /// Standard deviation if the prediction errors are white.
    pub white_deviation: f64,
    /// Standard deviation if they are correlated over up to half a second.
    pub robust_deviation: f64,
    /// Whether the estimate is at the bound of its range.
    pub at_bound: bool,
}

/// Half the width of a 95 % confidence interval, in standard deviations.
const NINETY_FIVE: f64 = 1.96;

/// The least standard deviation of a vehicle's parameter, over its value. A gyro that vibrates is in the
/// fitted motion too, not in its error alone: it moves the estimates of the simulated car by 0.2 %.
const FLOOR: f64 = 1.5e-3;

/// The estimates of a fit, in the order of the settings.
pub(super) fn estimates(start: &Values, settings: &Settings, fit: &Fit) -> Vec<Estimate> {
    let active = settings.parameters.iter().zip(&fit.u);
    active
        .enumerate()
        .map(|(index, (parameter, u))| {
            let prior = parameter.prior();
            let start = start.get(*parameter);
            let slope = prior.slope(start, *u).abs();
            let spread = &fit.spread;
            let deviation = spread.deviations[index];
            let value = prior.value(start, *u);
            let deviation = if Parameter::NUISANCE.contains(parameter) {
                deviation
            } else {
                deviation.hypot(FLOOR * value.abs() / slope)
            };
            let reach = NINETY_FIVE * deviation;
            Estimate {
                parameter: *parameter,
                start,
                value,
                standard_deviation: slope * deviation,
                interval: [u - reach, u + reach].map(|u| prior.value(start, u)),
                white_deviation: slope * spread.white[(index, index)].sqrt(),
                robust_deviation: slope * spread.robust[(index, index)].sqrt(),
                at_bound: parameter::Prior::is_at_bound(*u),
            }
        })
        .collect()
}

/// The correlations of the estimates, in the same order.
pub(super) fn correlation(fit: &Fit) -> DMatrix<f64> {
    let white = &fit.spread.white;
    DMatrix::from_fn(white.nrows(), white.ncols(), |row, column| {
        white[(row, column)] / (white[(row, row)] * white[(column, column)]).sqrt()
    })
}
