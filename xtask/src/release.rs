//! The release builds for the checks, from one build of the workspace.
//!
//! A package built alone has dependencies with other features than in the
//! workspace, which are then compiled again. All checks therefore name the same
//! packages, features and targets, and cargo builds nothing twice.

use std::{os::unix::process::CommandExt, path::PathBuf, process::Command};

use crate::{
    image::{self, Image},
    prerequisites::Part,
    process::{Failure, check},
    target,
    workspace::{cargo, cargo_here, root},
};

/// A release build.
#[derive(Clone, Copy)]
pub(crate) struct Release {
    /// Whether it includes the simulated Arduino.
    pub(crate) uno: bool,
}

/// The hardware-in-the-loop test target.
const SUITE: &str = "hil";

/// Features that need simavr and the image.
const UNO_FEATURES: &str = "singletrack-simavr/simavr,singletrack-sim/uno";

impl Release {
    /// The part whose prerequisites it needs.
    pub(crate) fn part(self) -> Option<Part> {
        self.uno.then_some(Part::Uno)
    }

    /// Cargo's arguments that name the packages and their features.
    fn selection(self) -> Vec<&'static str> {
        let mut arguments = vec!["--release", "--workspace"];
        arguments.extend(features(self.uno));
        arguments
    }

    /// The tests in virtual time. The hardware in the loop is a test target too, which runs only
    /// when it is named.
    pub(crate) fn tests(self) -> Command {
        let mut tests = cargo();
        tests.arg("test").args(self.selection());
        tests
    }

    /// Builds all programs and the hardware-in-the-loop suite.
    pub(crate) fn build(self) -> Result<(), Failure> {
        // Including that test, so that dependencies have the features that it
        // needs.
        check(
            cargo()
                .arg("build")
                .args(self.selection())
                .args(["--bins", "--test", SUITE]),
        )
    }

    /// Builds a program of the workspace.
    pub(crate) fn program(self, name: &str) -> Result<Command, Failure> {
        let mut command = Command::new(self.path(name)?);
        command.current_dir(root());
        Ok(command)
    }

    /// Builds a program of the workspace and returns its path.
    pub(crate) fn path(self, name: &str) -> Result<PathBuf, Failure> {
        self.build()?;
        Ok(target::folder()?.join("release").join(name))
    }

    /// Builds this source's image, with its simulator from this release build.
    pub(crate) fn image(self) -> Result<Image, Failure> {
        image::build(0, || self.build())
    }

    /// The hardware-in-the-loop suite; its own arguments follow.
    pub(crate) fn suite(self) -> Command {
        let mut command = cargo();
        command
            .arg("test")
            .args(self.selection())
            .args(["--test", SUITE, "--"]);
        command
    }
}

/// Builds a package's program of the same name, and the Arduino's image if it needs it, and
/// replaces this process by the program; returns only on failure. The program starts in the current
/// folder, from which its files are named. Cargo shows progress on a terminal.
pub(crate) fn run(package: &str, needs_image: bool, arguments: &[String]) -> Result<(), Failure> {
    if !target::folder()?.join("release").join(package).is_file() {
        eprintln!("Building {package}: the first build takes some minutes");
    }
    let mut cargo = cargo_here();
    if needs_image {
        let image = image::ensure(0, &[])?;
        cargo.env("SINGLETRACK_UNO", image.folder);
    }
    cargo
        .args(["run", "--release", "--package", package, "--bin", package])
        .args(image::quiet())
        .arg("--")
        .args(arguments);
    Err(Failure::new(format!(
        "cargo does not start: {}",
        cargo.exec()
    )))
}

/// The features of the workspace for the checks.
pub(crate) fn features(uno: bool) -> impl IntoIterator<Item = &'static str> {
    if uno {
        ["--features", UNO_FEATURES].as_slice()
    } else {
        &[]
    }
    .iter()
    .copied()
}
