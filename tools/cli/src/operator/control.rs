//! `singletrack disarm|stop`: requests to the running daemon.

use std::error::Error;

use clap::Args;
use singletrack_api::{Request, ask};
use singletrack_figures::output;

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
pub fn disarm(args: &DisarmArgs) -> Result<(), Box<dyn Error>> {
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
pub fn stop(args: &ControlArgs) -> Result<(), Box<dyn Error>> {
    ask(&Request::Stop {}, &args.socket)?;
    print(EMERGENCY_STOPPED)
}

/// The result of an emergency stop.
pub(crate) const EMERGENCY_STOPPED: &str = "stopped: neutral until the board is reset";

/// Prints a result. A closed pipe is no error.
pub(crate) fn print(text: &str) -> Result<(), Box<dyn Error>> {
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
