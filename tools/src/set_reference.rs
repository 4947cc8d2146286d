//! `singletrack set-reference`: another reference for a car that stands.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::Args;
use serde::Deserialize;
use serde_json::{Value, json};
use singletrack_core::config::ReferenceSection;
use singletrackd::SOCKET_VERSION;

use crate::control::{self, ControlArgs, ControlError};

/// What to drive along.
#[derive(Clone, Debug, Args)]
pub struct SetReferenceArgs {
    /// A TOML file with a table [reference], as in the daemon's configuration, and nothing else
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    control: ControlArgs,
}

/// Why the reference is the one of before.
#[derive(Debug, thiserror::Error)]
pub enum SetReferenceError {
    /// The file can't be read.
    #[error("can't read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// It is no reference.
    #[error(
        "{}: {source}a table [reference] is needed, as in the daemon's configuration, and nothing else",
        .path.display()
    )]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: toml::de::Error,
    },
    /// It can't be sent.
    #[error("{}: {source}; every path must be UTF-8", .path.display())]
    Send {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: serde_json::Error,
    },
    /// The daemon says no, or nothing.
    #[error(transparent)]
    Control(#[from] ControlError),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    reference: ReferenceSection,
}

/// Sends the reference and says which configuration it came into force with.
///
/// # Errors
///
/// When it is none, or the daemon does not take it.
pub fn run(args: &SetReferenceArgs) -> Result<(), SetReferenceError> {
    let reference = read(&args.file)?;
    let line = json!({
        "version": SOCKET_VERSION,
        "command": "set-reference",
        "reference": reference,
    });
    let answer = control::ask(&line, &args.control.socket)?;
    let number = answer.get("configuration").unwrap_or(&Value::Null);
    Ok(control::tell(&format!(
        "the car will drive along it: configuration {number} is in force"
    ))?)
}

/// The reference in a file, whose waypoints the daemon finds wherever it runs.
fn read(path: &Path) -> Result<Value, SetReferenceError> {
    let read = |source| SetReferenceError::Read {
        path: path.to_owned(),
        source,
    };
    let text = fs::read_to_string(path).map_err(read)?;
    let File { mut reference } =
        toml::from_str(&text).map_err(|source| SetReferenceError::Parse {
            path: path.to_owned(),
            source,
        })?;
    let path_of_file = std::path::absolute(path).map_err(read)?;
    if let Some(folder) = path_of_file.parent() {
        reference.resolve(folder);
    }
    serde_json::to_value(&reference).map_err(|source| SetReferenceError::Send {
        path: path.to_owned(),
        source,
    })
}
