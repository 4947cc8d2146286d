//! Warnings about the quality of the estimates.

use nalgebra::DMatrix;
use singletrack_control::{GRAVITY, Tyres};

use super::{
    data::{Channel, Span},
    filter::{Residuals, TrackPoint},
    fit::{Estimate, Fit},
    parameter::Parameter,
    settings::Criterion,
    simulation::{Output, Score},
};

/// A reason to doubt an identification.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    /// The drive hardly determines this parameter: its standard deviation over its value.
    #[error(
        "{} is poorly determined by this drive: its standard deviation is {:.0} % of its \
         value; steer more and faster at 1.5 m/s or more (docs/identification.md)",
        .0, 100.0 * .1
    )]
    NotTold(Parameter, f64),
    /// The drive does not distinguish these two parameters, with this correlation.
    #[error(
        "this drive does not distinguish {} from {} (correlation {:.3}): record another, \
         at several speeds and with steering steps to both sides", .0[0], .0[1], .1
    )]
    Alike([Parameter; 2], f64),
    /// The simulation's error was minimised instead of the prediction's.
    #[error(
        "the car does not behave as the model does, or the prediction's fit did not settle: the parameters are \
         those that simulate the drive best \
         (NMPE {nmpe:.3}{}), not those that predict the next sample best; they serve a simulation of such \
         drives, and the intervals hold for errors that are alike over two seconds",
        prediction.map_or_else(String::new, |nmpe| format!(", {nmpe:.3} with those"))
    )]
    Simulated {
        /// The normalised mean prediction error of the simulation.
        nmpe: f64,
        /// The error with the parameters that predict best; none if there are none.
        prediction: Option<f64>,
    },
    /// The board's periods that begin a servo pulse are uncertain: log-likelihood above that of the next
    /// candidate.
    #[error(
        "this drive hardly shows which of the board's records begin a servo pulse (log-likelihood \
         {:.1} above the next): the errors of delay, lag and {} may exceed their intervals; \
         steer in faster steps",
        .0, Parameter::YawInertia
    )]
    FramesGuessed(f64),
    /// There are forces of this density, in N/√Hz, that the model does not explain.
    #[error(
        "forces that the model does not explain are {:.0} mN/√Hz on an axle: mass, l_f, friction or the \
         steering gain may be wrong, and then the errors of the estimates far exceed their intervals; \
         estimate l_f and friction jointly (--parameters c_f,c_r,i_z,l_f,friction)", 1e3 * .0
    )]
    Unexplained(f64),
    /// The tyres are modelled as linear, and the car came near to sliding: the largest lateral
    /// acceleration over μ g.
    #[error(
        "linear tyres suit a car that does not slide, and this one reached {:.0} % of the friction: beyond \
         half of it the estimated stiffnesses are too small (docs/identification.md)", 100.0 * .0
    )]
    LinearTyres(f64),
    /// The usable part of the drive is short: its duration, in s.
    #[error("only {0:.0} s of the drive were used: a minute of weaving gives narrower intervals")]
    Short(f64),
    /// The model explains nothing of this output, with this fit in per cent.
    #[error(
        "the model explains nothing of the {} (fit {:.0} %): check the sign, the unit and the mounting of \
         what measures it", .0.name().replace('_', " "), .1
    )]
    Unfitted(Output, f64),
    /// The car was slow, so that the tyres hardly slipped: its mean speed, in m/s.
    #[error(
        "the mean speed was {0:.2} m/s, at which the tyres hardly slip: drive at 1.5 m/s or more"
    )]
    Slow(f64),
    /// The prediction errors are correlated over time.
    #[error(
        "the prediction errors of {} are not white (autocorrelation {autocorrelation:.2} after {lag} samples): \
         the model lacks some behaviour of the car, and the errors of the estimates may exceed \
         their intervals", .channel.name()
    )]
    Coloured {
        /// The channel.
        channel: Channel,
        /// The largest autocorrelation.
        autocorrelation: f64,
        /// Its lag, in samples.
        lag: usize,
    },
}

/// A parameter is poorly determined above this ratio of standard deviation to value.
const VAGUE: f64 = 0.2;
/// A drive is short below this duration, in s.
const SHORT: f64 = 20.0;
/// A drive is slow below this mean speed, in m/s.
const SLOW: f64 = 1.0;
/// Two parameters with a larger correlation cannot be distinguished.
const ALIKE: f64 = 0.995;
/// A larger autocorrelation is significant.
const COLOURED: f64 = 0.2;

/// The choice of the servo periods is uncertain below this difference of log-likelihoods.
const GUESS: f64 = 5.0;
/// A larger force density over the mean load of an axle cannot be sensor noise, in 1/√Hz.
const UNEXPLAINED: f64 = 5e-5;

/// Whether there are forces that the model does not explain.
pub(super) fn is_unexplained(fit: &Fit) -> bool {
    fit.noise.force_density > UNEXPLAINED * 0.5 * fit.values.vehicle().mass_kg * GRAVITY
}

/// Warnings from the fit itself.
pub(super) fn of_fit(fit: &Fit, tyres: Tyres, criterion: Criterion) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if fit.lead < GUESS {
        warnings.push(Warning::FramesGuessed(fit.lead));
    }
    let vehicle = fit.values.vehicle();
    if criterion == Criterion::Prediction && is_unexplained(fit) {
        warnings.push(Warning::Unexplained(fit.noise.force_density));
    }
    if tyres == Tyres::Linear {
        let track = fit.run.track.iter();
        let motions = track.map(|point| point.estimate.motion);
        let aside = motions.map(|motion| (motion.speed * motion.yaw_rate).abs());
        let share = aside.fold(0.0, f64::max) / (vehicle.friction * GRAVITY);
        warnings.push(Warning::LinearTyres(share));
    }
    warnings
}

/// Warnings from the simulation's score.
pub(super) fn of_score(score: &Score) -> Vec<Warning> {
    let measured = score.outputs.iter().filter(|one| !one.rms.is_nan());
    let unfitted = measured.filter(|one| one.fit_percent.is_nan() || one.fit_percent <= 0.0);
    let warnings = unfitted.map(|one| Warning::Unfitted(one.output, one.fit_percent));
    warnings.collect()
}

/// Warnings from the estimates, their correlations, the residuals and the drive.
pub(super) fn warnings(
    estimates: &[Estimate],
    correlation: &DMatrix<f64>,
    residuals: &[Residuals],
    stretches: &[Span],
    track: &[TrackPoint],
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for estimate in estimates {
        let parameter = estimate.parameter;
        let relative = estimate.standard_deviation / estimate.value.abs();
        let ratio = !Parameter::NUISANCE.contains(&parameter);
        if ratio && (relative.is_nan() || relative > VAGUE) {
            warnings.push(Warning::NotTold(parameter, relative));
        }
    }
    for (index, one) in estimates.iter().enumerate() {
        for (offset, other) in estimates.iter().skip(index + 1).enumerate() {
            let correlation = correlation[(index, index + 1 + offset)];
            let vague = |estimate: &Estimate| {
                let deviation = estimate.standard_deviation;
                deviation.is_nan() || deviation > VAGUE * estimate.value.abs()
            };
            if correlation.abs() > ALIKE && (vague(one) || vague(other)) {
                let parameters = [one.parameter, other.parameter];
                warnings.push(Warning::Alike(parameters, correlation));
            }
        }
    }
    let seconds: f64 = stretches.iter().map(Span::seconds).sum();
    if seconds < SHORT {
        warnings.push(Warning::Short(seconds));
    }
    let count = track.len().max(1) as f64;
    let speed = track.iter().map(TrackPoint::speed_m_s).sum::<f64>() / count;
    if speed < SLOW {
        warnings.push(Warning::Slow(speed));
    }
    for residuals in residuals {
        let worst = (1..)
            .zip(&residuals.autocorrelation)
            .max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
        if let Some((lag, autocorrelation)) = worst
            && autocorrelation.abs() > COLOURED
        {
            warnings.push(Warning::Coloured {
                channel: residuals.channel,
                autocorrelation: *autocorrelation,
                lag,
            });
        }
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_that_the_drive_hardly_determines_is_named_unless_it_is_a_nuisance() {
        let estimate = |parameter, standard_deviation| Estimate {
            parameter,
            start: 2.0,
            value: 2.0,
            standard_deviation,
            interval: [1.0, 3.0],
            white_deviation: standard_deviation,
            robust_deviation: standard_deviation,
            at_bound: false,
        };
        let named = |deviation| {
            let nuisances = Parameter::NUISANCE.map(|parameter| estimate(parameter, 10.0));
            let estimates: Vec<Estimate> = nuisances
                .into_iter()
                .chain([
                    estimate(Parameter::FrontStiffness, 0.01),
                    estimate(Parameter::RearStiffness, deviation),
                ])
                .collect();
            let correlation = DMatrix::zeros(estimates.len(), estimates.len());
            let found = warnings(&estimates, &correlation, &[], &[], &[]);
            let vague = found.into_iter().filter_map(|warning| match warning {
                Warning::NotTold(parameter, _) => Some(parameter),
                _ => None,
            });
            vague.collect::<Vec<_>>()
        };
        assert_eq!(named(2.0 * (VAGUE - 0.01)), []);
        for deviation in [2.0 * (VAGUE + 0.01), f64::NAN, f64::INFINITY] {
            assert_eq!(named(deviation), [Parameter::RearStiffness]);
        }
    }
}
