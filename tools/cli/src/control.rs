//! `singletrack disarm|stop`: requests to the running daemon.

use std::{
    io::{self, Write},
    os::unix::net::UnixStream,
    path::Path,
};

use clap::Args;
use singletrack_api::{Answer, ClientError, Request};

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

/// A request to the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlCommand {
    /// Slow down, stop and disarm.
    Disarm,
    /// Neutral at once, until the board is reset.
    Stop,
}

impl ControlCommand {
    const fn request(self) -> Request {
        match self {
            Self::Disarm => Request::DISARM,
            Self::Stop => Request::Stop {},
        }
    }
}

/// Why the request failed.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The daemon can't be asked, or refuses.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The output can't be written.
    #[error("can't write to standard output: {0}")]
    Output(io::Error),
}

impl From<io::Error> for ControlError {
    fn from(error: io::Error) -> Self {
        ClientError::from(error).into()
    }
}

impl From<serde_json::Error> for ControlError {
    fn from(error: serde_json::Error) -> Self {
        ClientError::from(error).into()
    }
}

/// Disarms, and says that the car was carried if that is asked for.
///
/// # Errors
///
/// Those of [`run`].
pub fn disarm(args: &DisarmArgs) -> Result<(), ControlError> {
    if !args.carried {
        return run(ControlCommand::Disarm, &args.control);
    }
    ask(
        &Request::Disarm {
            at_once: false,
            carried: true,
        },
        &args.control.socket,
    )?;
    print("the car is where the cameras show it; singletrack status says when it is ready")
}

/// Sends the request and prints the result in words.
/// A closed pipe is no error.
///
/// # Errors
///
/// When it can't be asked, or refuses; the reason is the daemon's.
pub fn run(command: ControlCommand, args: &ControlArgs) -> Result<(), ControlError> {
    let answer = ask(&command.request(), &args.socket)?;
    print(&match command {
        // An emergency stop stays in force: the daemon then answers with a note.
        ControlCommand::Disarm => answer.note.map_or_else(
            || "disarming: the car slows down and stops".to_owned(),
            Into::into,
        ),
        ControlCommand::Stop => "stopped: neutral until the board is reset".to_owned(),
    })
}

/// Prints a result. A closed pipe is no error.
pub(crate) fn print(text: &str) -> Result<(), ControlError> {
    let mut stdout = io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(ControlError::Output(error)),
        _ => Ok(()),
    }
}

pub(crate) fn connect(path: &Path) -> Result<UnixStream, ControlError> {
    Ok(singletrack_api::connect(path)?)
}

/// The daemon's answer to one request, unless it is a refusal.
pub(crate) fn ask(request: &Request, path: &Path) -> Result<Answer, ControlError> {
    Ok(singletrack_api::ask(request, path)?)
}
