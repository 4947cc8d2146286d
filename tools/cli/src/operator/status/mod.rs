//! `singletrack status`: what the daemon does now, for a person or for programs.

mod summary;
mod watch;

use std::time::Duration;

use clap::Args;
use serde_json::Value;
use singletrack_api::{Request, ask};

use crate::operator::control::{ControlArgs, ControlError, print};
use summary::Summary;

/// Options of `singletrack status`.
#[derive(Clone, Debug, Args)]
pub struct StatusArgs {
    #[command(flatten)]
    control: ControlArgs,
    /// Print the whole status as JSON, for programs
    #[arg(long, conflicts_with = "watch")]
    json: bool,
    /// Show the status until q or Ctrl-C is pressed, renewed ten times a second; without a
    /// terminal, print a line a second
    #[arg(long)]
    watch: bool,
}

/// The longest wait for the answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// Prints the status. A closed pipe is no error.
///
/// # Errors
///
/// When the daemon can't be asked, or refuses.
pub fn run(args: &StatusArgs) -> Result<(), ControlError> {
    let socket = &args.control.socket;
    if args.watch {
        return watch::run(socket);
    }
    if args.json {
        // As the daemon wrote it, which may be newer than this program.
        let line = singletrack_api::ask_for_line(&Request::Status {}, socket, PATIENCE)?;
        let mut answer: Value = serde_json::from_str(&line)?;
        let status = answer.get_mut("status").map(Value::take);
        return print(&serde_json::to_string_pretty(&status.unwrap_or(answer))?);
    }
    let status = ask(&Request::Status {}, socket)?.status;
    print(&status.map_or_else(|| UNKNOWN.to_owned(), |status| Summary::of(status).line()))
}

/// The line for an answer that has no status.
const UNKNOWN: &str = "; pose none, battery unknown, link unknown, speed unknown";
