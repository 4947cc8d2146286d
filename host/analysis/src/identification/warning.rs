//! What whoever uses the estimates should know of them.

use singletrack_control::{GRAVITY, Tyres};

use super::{
    channel::Channel, data::Span, estimate::Estimate, filter::TrackPoint, fit::Fit,
    parameter::Parameter, residuals::Residuals,
};

/// Something about an identification that makes it less than it seems.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    /// The drive does not tell it.
    #[error(
        "{parameter} is hardly told by this drive: its standard deviation is {:.0} % of its value; \
         steer more and faster at 1.5 m/s or more (docs/identification.md)",
        100.0 * relative
    )]
    NotTold {
        /// The parameter.
        parameter: Parameter,
        /// Its standard deviation over its value.
        relative: f64,
    },
    /// It would have gone on.
    #[error(
        "{parameter} went as far as it may, from {start} to {value}: start closer to the car \
         (--vehicle), and check mass, wheelbase and the servo's calibration"
    )]
    AtBound {
        /// The parameter.
        parameter: Parameter,
        /// Where it started.
        start: f64,
        /// Where it is.
        value: f64,
    },
    /// Two can't be told from each other.
    #[error(
        "{} and {} can't be told apart on this drive (correlation {correlation:.3}): drive another, \
         at several speeds and with steps of the steering to both sides", .parameters[0], .parameters[1]
    )]
    Alike {
        /// Which two.
        parameters: [Parameter; 2],
        /// Their correlation.
        correlation: f64,
    },
    /// The fit was still moving.
    #[error(
        "the fit has not settled: its last turn moved a parameter by {moved:.2} standard deviations; \
         take the estimates for a start (--vehicle) of another"
    )]
    NotSettled {
        /// How far, in standard deviations.
        moved: f64,
    },
    /// Which records begin a servo pulse is a guess.
    #[error(
        "which of the board's records begin a servo pulse can hardly be told from this drive (log-likelihood \
         {lead:.1} above the next): delay, lag and {} may be off by more than their intervals say; \
         steer in faster steps",
        Parameter::YawInertia
    )]
    FramesGuessed {
        /// How much likelier than the next, as a logarithm.
        lead: f64,
    },
    /// Forces that the model does not know.
    #[error(
        "forces that the model does not know are {:.0} mN/√Hz on an axle: mass, l_f, friction or the steering's \
         gain may be wrong, and the estimates with them by far more than their intervals say; estimate \
         l_f and friction along (--parameters c_f,c_r,i_z,l_f,friction)", 1e3 * density
    )]
    Unexplained {
        /// Their density, in N/√Hz.
        density: f64,
    },
    /// Linear tyres never slide.
    #[error(
        "linear tyres fit a car that does not slide, and this one reached {:.0} % of the friction: beyond \
         half of it the stiffnesses come out too small (docs/identification.md)", 100.0 * share
    )]
    LinearTyres {
        /// The largest acceleration to the side over μ g.
        share: f64,
    },
    /// Little was used.
    #[error(
        "only {seconds:.0} s of the drive were used: a minute of weaving makes the intervals narrower"
    )]
    Short {
        /// How much, in s.
        seconds: f64,
    },
    /// The tyres hardly slipped.
    #[error(
        "the car drove at {speed:.2} m/s in the mean, where the tyres hardly slip: drive at 1.5 m/s or more"
    )]
    Slow {
        /// Its mean speed, in m/s.
        speed: f64,
    },
    /// The model is not all there is.
    #[error(
        "the prediction errors of {} are not white (autocorrelation {autocorrelation:.2} after {lag} samples): \
         the car does something that the model does not know, and the estimates may be off by more \
         than their intervals say", .channel.name()
    )]
    Coloured {
        /// Of what.
        channel: Channel,
        /// How much.
        autocorrelation: f64,
        /// After how many samples.
        lag: usize,
    },
}

/// A standard deviation above this part of the value tells nothing.
const VAGUE: f64 = 0.2;
/// Less is short, in s.
const SHORT: f64 = 20.0;
/// Less is slow, in m/s.
const SLOW: f64 = 1.0;
/// A correlation beyond this is one of two parameters in one.
const ALIKE: f64 = 0.995;
/// An autocorrelation beyond this is no chance.
const COLOURED: f64 = 0.2;

/// Two kinds of frames this close are a guess.
const GUESS: f64 = 5.0;
/// A force this part of an axle's mean load is not the sensors', in 1/√Hz.
const UNEXPLAINED: f64 = 5e-5;

/// What the fit says of itself.
pub(super) fn of_fit(fit: &Fit, tyres: Tyres) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if let Some(moved) = fit.unsettled {
        warnings.push(Warning::NotSettled { moved });
    }
    if fit.lead < GUESS {
        warnings.push(Warning::FramesGuessed { lead: fit.lead });
    }
    let vehicle = fit.values.vehicle();
    let density = fit.noise.force_density;
    if density > UNEXPLAINED * 0.5 * vehicle.mass_kg * GRAVITY {
        warnings.push(Warning::Unexplained { density });
    }
    if tyres == Tyres::Linear {
        let track = fit.passage.track.iter();
        let aside = track.map(|point| (point.speed_m_s * point.yaw_rate_rad_s).abs());
        let share = aside.fold(0.0, f64::max) / (vehicle.friction * GRAVITY);
        warnings.push(Warning::LinearTyres { share });
    }
    warnings
}

pub(super) fn warnings(
    estimates: &[Estimate],
    correlation: impl Fn(usize, usize) -> f64,
    residuals: &[Residuals],
    stretches: &[Span],
    track: &[TrackPoint],
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for estimate in estimates {
        let Estimate {
            parameter,
            start,
            value,
            ..
        } = *estimate;
        let relative = estimate.standard_deviation / value.abs();
        let ratio = !Parameter::NUISANCE.contains(&parameter);
        if ratio && (relative.is_nan() || relative > VAGUE) {
            warnings.push(Warning::NotTold {
                parameter,
                relative,
            });
        }
        if estimate.at_bound {
            warnings.push(Warning::AtBound {
                parameter,
                start,
                value,
            });
        }
    }
    for (index, one) in estimates.iter().enumerate() {
        for (offset, other) in estimates.iter().skip(index + 1).enumerate() {
            let correlation = correlation(index, index + 1 + offset);
            let vague = |estimate: &Estimate| {
                estimate.standard_deviation.is_nan()
                    || estimate.standard_deviation > VAGUE * estimate.value.abs()
            };
            if correlation.abs() > ALIKE && (vague(one) || vague(other)) {
                warnings.push(Warning::Alike {
                    parameters: [one.parameter, other.parameter],
                    correlation,
                });
            }
        }
    }
    let seconds: f64 = stretches.iter().map(Span::seconds).sum();
    if seconds < SHORT {
        warnings.push(Warning::Short { seconds });
    }
    let count = track.len().max(1) as f64;
    let speed = track.iter().map(|point| point.speed_m_s).sum::<f64>() / count;
    if speed < SLOW {
        warnings.push(Warning::Slow { speed });
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
