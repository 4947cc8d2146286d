//! The release builds that the checks run: all of them in one build of the workspace.
//!
//! A package that is built by itself has dependencies with other features than in the
//! workspace, and they would be compiled again. So every check names the same packages,
//! features and kinds of target, and cargo builds nothing twice.

use std::{os::unix::process::CommandExt, path::PathBuf, process::Command};

use crate::{
    image::Progress,
    prerequisites::Part,
    process::{Failure, check},
    target,
    workspace::{cargo, root},
};

/// Which release build.
#[derive(Clone, Copy)]
pub(crate) struct Release {
    /// Whether the simulated Arduino is part of it.
    pub(crate) uno: bool,
}

/// The test target with hardware in the loop.
const SUITE: &str = "hil";

/// What takes simavr, and the image, to build.
const UNO_FEATURES: &str = "singletrack-simavr/simavr,singletrack-sim/uno";

impl Release {
    /// The part whose prerequisites it needs.
    pub(crate) fn part(self) -> Option<Part> {
        self.uno.then_some(Part::Uno)
    }

    /// Cargo's arguments that name the packages and their features.
    fn selection(self) -> Vec<&'static str> {
        let mut arguments = vec!["--release", "--workspace"];
        // They are run from debug builds alone.
        arguments.extend(["--exclude", "xtask", "--exclude", "singletrack-fuzz"]);
        arguments.extend(features(self.uno));
        arguments
    }

    /// Builds all programs, and the suite for hardware in the loop.
    pub(crate) fn build(self) -> Result<(), Failure> {
        // With that test among them: dependencies then have the features that it asks for.
        check(
            cargo()
                .arg("build")
                .args(self.selection())
                .args(["--bins", "--test", SUITE]),
        )
    }

    /// A program of the workspace, built.
    pub(crate) fn program(self, name: &str) -> Result<Command, Failure> {
        let mut command = Command::new(self.path(name)?);
        command.current_dir(root());
        Ok(command)
    }

    /// Where a program of the workspace is; it is built before.
    pub(crate) fn path(self, name: &str) -> Result<PathBuf, Failure> {
        self.build()?;
        Ok(target::folder()?.join("release").join(name))
    }

    /// The suite for hardware in the loop; its own arguments follow.
    pub(crate) fn suite(self) -> Command {
        let mut command = cargo();
        command
            .arg("test")
            .args(self.selection())
            .args(["--test", SUITE, "--"]);
        command
    }
}

/// Says so when a program is about to be built for the first time.
pub(crate) fn announce(program: &str) -> Result<(), Failure> {
    if !target::folder()?.join("release").join(program).is_file() {
        eprintln!("Building {program}: the first time takes some minutes");
    }
    Ok(())
}

/// Becomes `cargo run` with arguments for the program; returns only when that fails. The
/// build shows cargo's progress on a terminal.
pub(crate) fn become_program(mut cargo_run: Command, arguments: &[String]) -> Result<(), Failure> {
    cargo_run
        .args(Progress::of_stderr().option())
        .arg("--")
        .args(arguments);
    Err(Failure::new(format!(
        "cargo does not start: {}",
        cargo_run.exec()
    )))
}

/// The features with which checks build the workspace.
pub(crate) fn features(uno: bool) -> impl IntoIterator<Item = &'static str> {
    if uno {
        ["--features", UNO_FEATURES].as_slice()
    } else {
        &[]
    }
    .iter()
    .copied()
}
