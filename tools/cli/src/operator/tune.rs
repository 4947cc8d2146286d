//! `singletrack tune`: other gains or another p, also while the car drives.

use std::error::Error;

use clap::Args;
use singletrack_api::{Gain, Request, Tune, Tuning, ask};

use crate::operator::control::{self, ControlArgs, finite};

/// The new values.
#[derive(Clone, Debug, Args)]
#[command(arg_required_else_help = false)]
pub struct TuneArgs {
    /// Gains of the position loop along x and y, in 1/s; one number is for both
    #[arg(long, value_name = "X[,Y]", value_parser = gains)]
    #[arg(required_unless_present = "point_distance")]
    gain: Option<[f64; 2]>,
    /// Distance p of the point P from the front axle, in m; it changes by 0.05 m/s
    #[arg(long, value_name = "M", value_parser = finite)]
    point_distance: Option<f64>,
    #[command(flatten)]
    control: ControlArgs,
}

fn gains(text: &str) -> Result<[f64; 2], String> {
    let (x, y) = text.split_once(',').unwrap_or((text, text));
    Ok([finite(x)?, finite(y)?])
}

/// Sends the values and prints what is in force.
///
/// # Errors
///
/// The daemon refuses the values, with their bounds, or can't be asked.
pub fn run(args: &TuneArgs) -> Result<(), Box<dyn Error>> {
    let request = Request::Tune(Tune {
        gain_per_s: args.gain.map(Gain::Each),
        point_distance_m: args.point_distance,
    });
    let answer = ask(&request, &args.control.socket)?;
    let tuning = answer.tuning.as_ref().map(in_words);
    control::print(&format!("tuned: {}", tuning.unwrap_or_default()))
}

/// Values of the control socket in words: `gains 2 and 2 per s, p 0.36 m (going to 0.4 m)`.
pub(crate) fn in_words(tuning: &Tuning) -> String {
    let gains = tuning.gain_per_s;
    let gains = gains.map(|[x, y]| format!("gains {} and {} per s, ", text(x), text(y)));
    let distance = tuning.point_distance_m;
    let wanted = tuning.wanted_point_distance_m;
    let wanted = wanted.filter(|wanted| *wanted != distance);
    let wanted = wanted.map(|wanted| format!(" (going to {} m)", text(wanted)));
    format!(
        "{}p {} m{}",
        gains.unwrap_or_default(),
        text(distance),
        wanted.unwrap_or_default()
    )
}

/// With four digits after the point at most.
fn text(number: f64) -> String {
    ((number * 1e4).round() / 1e4).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_gain_is_for_both_axes_and_only_numbers_are_gains() {
        assert_eq!(gains("2"), Ok([2.0, 2.0]));
        assert_eq!(gains("2,1.5"), Ok([2.0, 1.5]));
        for wrong in ["", "2,", ",2", "2,1.5,1", "nan", "2,inf", "--help"] {
            assert!(gains(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn values_are_told_in_words() {
        let tuning = Tuning {
            gain_per_s: Some([2.0, 1.5]),
            point_distance_m: 0.360_499_999_9,
            wanted_point_distance_m: Some(0.4),
        };
        assert_eq!(
            in_words(&tuning),
            "gains 2 and 1.5 per s, p 0.3605 m (going to 0.4 m)"
        );
        let there = Tuning {
            gain_per_s: None,
            point_distance_m: 0.4,
            ..tuning
        };
        assert_eq!(in_words(&there), "p 0.4 m");
    }
}
