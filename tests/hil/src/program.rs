//! Builds the daemon's program once, as it is shipped.

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde_json::Value;

use crate::{Failure, Outcome};

/// Builds `singletrackd` in the release profile, independent of the tests' own
/// profile, and returns its path.
///
/// # Errors
///
/// Fails if it does not build; the compiler prints the errors.
pub fn build() -> Outcome<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
    let mut command = Command::new(&cargo);
    // Set by cargo for a test: the present path of the checkout, not the compiled one.
    if let Some(package) = std::env::var_os("CARGO_MANIFEST_DIR") {
        command.current_dir(Path::new(&package).join("../.."));
    }
    let output = command
        // With the suite's own features, so that the libraries are not built again.
        .args(["build", "--release", "--bins"])
        .args(["--package", "singletrackd", "--package", "singletrack"])
        .args(["--package", "singletrack-sim"])
        .arg("--message-format=json-render-diagnostics")
        .stderr(Stdio::inherit())
        .output()
        .map_err(Failure::system(format!("can't run {}", cargo.display())))?;
    if !output.status.success() {
        return Err(Failure::new(format!(
            "singletrackd does not build ({}); see above, or try `cargo build --release -p singletrackd`",
            output.status
        )));
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| {
            message["reason"] == "compiler-artifact" && message["target"]["name"] == "singletrackd"
        })
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .ok_or_else(|| Failure::new("cargo has built no program named singletrackd"))
}
