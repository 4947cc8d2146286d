//! `singletrack set-reference`: replaces the reference of a standing car.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use serde::Deserialize;
use serde_json::Value;
use singletrack_api::{Request, ask};
use singletrack_core::{config::ReferenceSection, feasibility::Severity};
use singletrack_settings::explain;

use crate::operator::control::{self, ControlArgs};

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
pub fn run(args: &SetReferenceArgs) -> Result<(), Box<dyn Error>> {
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
    control::print(&format!(
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
pub(crate) fn read_reference(path: &Path) -> Result<Value, Box<dyn Error>> {
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
