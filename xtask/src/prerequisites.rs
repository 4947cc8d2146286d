//! Prerequisites of the checks, which `prerequisites.sh` probes and installs.

use std::{
    path::PathBuf,
    process::{Command, Stdio},
};

use singletrack_words::words;

use crate::{
    process::{Failure, failure},
    workspace::root,
};

words! {
    /// An optional part of the checks, with its prerequisites in `prerequisites.sh`.
    pub(crate) enum Part {
        /// The Arduino's image, and the simulated Arduino that runs it.
        Uno = "uno",
        /// The build for the Odroid, emulated.
        Odroid = "odroid",
        /// The Python readers of records.
        Readers = "readers",
        /// The Python package.
        Python = "python",
        /// ROS 2 in Python.
        Ros = "ros",
        /// Cars on other computers by way of a zenoh router.
        Zenoh = "zenoh",
        /// Octave, for MATLAB's language.
        Octave = "octave",
        /// The page in a browser.
        Browser = "browser",
        /// Campaigns on a cluster.
        Slurm = "slurm",
        /// systemd's verification of the service.
        Units = "units",
        /// The Debian package.
        Debian = "debian",
    }
}

/// Probes what parts of `prerequisites.sh` need, and installs or upgrades the packages of what is not
/// met. Fails with one message about all that remains.
pub(crate) fn ensure(parts: &[&str]) -> Result<(), Failure> {
    answer(script("ensure").args(parts)).map(drop)
}

/// What a probe of `prerequisites.sh` prints.
pub(crate) fn find(probe: &str) -> Result<String, Failure> {
    answer(script("find").args(probe.split(' ')))
}

/// A Python that creates environments.
pub(crate) fn python() -> Result<PathBuf, Failure> {
    find("find_python").map(PathBuf::from)
}

fn script(function: &str) -> Command {
    let mut script = Command::new(root().join("xtask/src/prerequisites.sh"));
    script.arg(function);
    script
}

/// What a script prints; its failure, if it fails.
fn answer(script: &mut Command) -> Result<String, Failure> {
    let output = script
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output();
    let output = output.map_err(|error| failure!("prerequisites.sh does not start: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout)
        .trim_end()
        .to_owned();
    if output.status.success() {
        Ok(text)
    } else {
        Err(Failure::Failed(text))
    }
}

#[cfg(test)]
mod tests;
