//! `singletrack status`: what the daemon does now, for a person or for programs.

mod reasons;
mod summary;
mod watch;

use clap::Args;
use serde_json::{Value, json};
use singletrackd::SOCKET_VERSION;

use crate::control::{ControlArgs, ControlError, ask, print};
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
    let answer = ask(&question(), socket)?;
    let status = answer.get("status").unwrap_or(&answer);
    print(&if args.json {
        serde_json::to_string_pretty(status)?
    } else {
        Summary::of(status).line()
    })
}

fn question() -> Value {
    json!({ "version": SOCKET_VERSION, "command": "status" })
}
