//! `singletrack status|disarm|stop`: requests to the running daemon.

use std::{
    io::{self, BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
};

use clap::Args;
use serde_json::{Value, json};
use singletrack_core::config::SocketSection;
use singletrackd::SOCKET_VERSION;

/// Where the daemon listens.
#[derive(Clone, Debug, Args)]
pub struct ControlArgs {
    /// The daemon's control socket
    #[arg(long, value_name = "PATH", default_value_os_t = SocketSection::default().path)]
    pub(crate) socket: PathBuf,
}

/// A request to the daemon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlCommand {
    /// Its status.
    Status,
    /// Slow down, stop and disarm.
    Disarm,
    /// Neutral at once, until the board is reset.
    Stop,
}

impl ControlCommand {
    const fn name(self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Disarm => "disarm",
            Self::Stop => "stop",
        }
    }
}

/// Why the request failed.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// No process listens at the socket.
    #[error(
        "can't reach the daemon at {}: {source}; is singletrackd running, with this socket.path?",
        path.display()
    )]
    Connect {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The connection failed.
    #[error("lost the connection to the daemon: {0}")]
    BrokeOff(#[from] io::Error),
    /// The answer can't be read.
    #[error("can't understand the daemon's answer: {0}; is it the same version as singletrack?")]
    Answer(#[from] serde_json::Error),
    /// The output can't be written.
    #[error("can't write to standard output: {0}")]
    Output(io::Error),
    /// The daemon refuses.
    #[error("{0}")]
    Refused(String),
}

/// Sends the request and prints the result: the status as JSON, any other in words.
/// A closed pipe is no error.
///
/// # Errors
///
/// When it can't be asked, or refuses; the reason is the daemon's.
pub fn run(command: ControlCommand, args: &ControlArgs) -> Result<(), ControlError> {
    let answer = ask(
        &json!({ "version": SOCKET_VERSION, "command": command.name() }),
        &args.socket,
    )?;
    print(&match command {
        ControlCommand::Status => {
            serde_json::to_string_pretty(answer.get("status").unwrap_or(&answer))?
        }
        // An emergency stop stays in force: the daemon then answers with a note.
        ControlCommand::Disarm => match answer.get("note").and_then(Value::as_str) {
            Some(note) => note.to_owned(),
            None => "disarming: the car slows down and stops".to_owned(),
        },
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
    UnixStream::connect(path).map_err(|source| ControlError::Connect {
        path: path.to_owned(),
        source,
    })
}

/// The daemon's answer to one line, unless it is a refusal.
pub(crate) fn ask(line: &Value, path: &Path) -> Result<Value, ControlError> {
    let mut stream = connect(path)?;
    stream.write_all(format!("{line}\n").as_bytes())?;
    let mut answer = String::new();
    if BufReader::new(stream).read_line(&mut answer)? == 0 {
        return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
    }
    agreed(serde_json::from_str(&answer)?)
}

/// An answer, unless it is a refusal.
pub(crate) fn agreed(answer: Value) -> Result<Value, ControlError> {
    if answer.get("ok").and_then(Value::as_bool) == Some(true) {
        return Ok(answer);
    }
    let error = answer.get("error").and_then(Value::as_str);
    Err(ControlError::Refused(
        error.map_or_else(|| answer.to_string(), str::to_owned),
    ))
}
