//! `singletrack disarm|stop|tune|set-reference`: requests to the running daemon.

use std::{
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use serde::Deserialize;
use serde_json::Value;
use singletrack_api::{Gain, Request, Tune, Tuning, ask};
use singletrack_core::{config::ReferenceSection, feasibility::Severity};
use singletrack_figures::output;
use singletrack_settings::explain;

use crate::Result;

pub use crate::arguments::ControlArgs;

/// Options of `singletrack disarm`.
#[derive(Clone, Debug, Args)]
pub struct DisarmArgs {
    /// The body that the cameras show is the car, though its wheels can't have brought it there: it
    /// was carried
    #[arg(long)]
    carried: bool,

    #[command(flatten)]
    control: ControlArgs,
}

/// Disarms, or says that the car was carried, and prints the result in words.
///
/// # Errors
///
/// When the daemon can't be asked, or refuses; the reason is the daemon's.
pub fn disarm(args: &DisarmArgs) -> Result<()> {
    let request = Request::Disarm {
        at_once: false,
        carried: args.carried,
    };
    let answer = ask(&request, &args.control.socket)?;
    if args.carried {
        return print(
            "the car is where the cameras show it; singletrack status says when it is ready",
        );
    }
    // An emergency stop stays in force: the daemon then answers with a note.
    let note = answer.note.as_deref();
    print(note.unwrap_or("disarming: the car slows down and stops"))
}

/// Stops the car at once, and prints the result in words.
///
/// # Errors
///
/// Those of [`disarm`].
pub fn stop(args: &ControlArgs) -> Result<()> {
    ask(&Request::Stop {}, &args.socket)?;
    print(EMERGENCY_STOPPED)
}

/// The result of an emergency stop.
pub(crate) const EMERGENCY_STOPPED: &str = "stopped: neutral until the board is reset";

/// Prints a result. A closed pipe is no error.
pub(crate) fn print(text: &str) -> Result<()> {
    let printed = output::print(&format!("{text}\n"));
    printed.map_err(|error| format!("can't write to standard output: {error}").into())
}

/// A number that is neither infinite nor NaN.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err("write a finite number, such as 0.5".to_owned()),
    }
}

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
pub fn tune(args: &TuneArgs) -> Result<()> {
    let request = Request::Tune(Tune {
        gain_per_s: args.gain.map(Gain::Each),
        point_distance_m: args.point_distance,
    });
    let answer = ask(&request, &args.control.socket)?;
    let tuning = answer.tuning.as_ref().map(in_words);
    print(&format!("tuned: {}", tuning.unwrap_or_default()))
}

/// Values of the control socket in words: `gains 2 and 2 per s, p 0.36 m (going to 0.4 m)`.
pub(crate) fn in_words(tuning: &Tuning) -> String {
    let gains = tuning.gain_per_s;
    let gains = gains.map(|[x, y]| format!("gains {} and {} per s, ", text(x), text(y)));
    let distance = tuning.point_distance_m;
    let wanted = tuning.wanted_point_distance_m;
    let wanted = wanted.filter(|wanted| *wanted != distance);
    let wanted = wanted.map(|wanted| format!(" (going to {} m)", text(wanted)));
    let (gains, wanted) = (gains.unwrap_or_default(), wanted.unwrap_or_default());
    format!("{gains}p {} m{wanted}", text(distance))
}

/// With four digits after the point at most.
fn text(number: f64) -> String {
    ((number * 1e4).round() / 1e4).to_string()
}

/// The new reference.
#[derive(Clone, Debug, Args)]
pub struct SetReferenceArgs {
    /// A TOML file with a table [reference], as in the daemon's configuration, and nothing else
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    control: ControlArgs,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    reference: ReferenceSection,
}

/// Sends the reference and prints the number of the configuration that has it.
///
/// # Errors
///
/// The file is not a reference, the daemon refuses it, or the car can't drive it from where it stands.
pub fn set_reference(args: &SetReferenceArgs) -> Result<()> {
    let reference = read_reference(&args.file)?;
    let request = Request::SetReference { reference };
    let answer = ask(&request, &args.control.socket)?;
    let word = format!("{}: ", Severity::Impossible.name());
    let is_impossible = |finding: &String| finding.starts_with(&word);
    let (impossible, warnings): (Vec<_>, Vec<_>) =
        answer.warnings.into_iter().partition(is_impossible);
    for warning in warnings {
        eprintln!("singletrack: warning: {warning}");
    }
    let number = answer.configuration.unwrap_or_default();
    print(&format!(
        "reference replaced: configuration {number} is in force"
    ))?;
    if impossible.is_empty() {
        return Ok(());
    }
    Err(impossible.join("; ").into())
}

/// The longest reference that is sent in a line of 16,384 bytes.
const LONGEST: usize = 16_000;

/// The reference in a file, with its points, or with the absolute path of their file if they are too
/// many: the daemon runs in another folder.
pub(crate) fn read_reference(path: &Path) -> Result<Value> {
    let name = path.display();
    let read = |error| format!("can't read {name}: {error}");
    let text = fs::read_to_string(path).map_err(read)?;
    let File { mut reference } = toml::from_str(&text).map_err(|error| {
        let message = explain(&text, &error);
        format!(
            "{name}: {message} (the file must have a table [reference], as in the daemon's \
             configuration, and nothing else)"
        )
    })?;
    let path_of_file = std::path::absolute(path).map_err(read)?;
    if let Some(folder) = path_of_file.parent() {
        reference.resolve(folder);
    }
    let value = |reference: &ReferenceSection| {
        serde_json::to_value(reference)
            .map_err(|error| format!("{name}: {error}; every path must be UTF-8"))
    };
    // The daemon reads files of one folder only. What fits into a line is sent.
    let written = value(&reference.with_points_inlined()?)?;
    if written.to_string().len() <= LONGEST {
        return Ok(written);
    }
    Ok(value(&reference)?)
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
