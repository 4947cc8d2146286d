//! Daemon and tools for the Odroid XU4: 32-bit ARM with hard float (Debian's armhf).

use std::{path::PathBuf, process::Stdio};

use crate::{
    prerequisites,
    process::{Failure, check, failure, text},
    programs::{Packages, compare},
    toolchain::ARMHF,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Build singletrackd and singletrack for the Odroid and print their paths.
Installs missing Debian packages.
";

/// Without the commands that reproduce the paper, which are not for the car.
const INSTALLED: &[&str] = &[
    "--package",
    "singletrack",
    "--no-default-features",
    "--features",
    "singletrack/desk,singletrack/live,singletrack/page",
];

/// The daemon, and what simulates the compared bits; this combination of features is linted only here.
const COMPARED: &[&str] = &[
    "--package",
    "singletrack-scenario",
    "--bin",
    "singletrackd",
    "--example",
    "trajectory",
    "--no-default-features",
    "--features",
    "singletrack-scenario/files",
    "-Zwarnings",
    "--config",
    "build.warnings=\"deny\"",
];

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match arguments {
        [] => {
            prerequisites::ensure(&prerequisites::ODROID)?;
            let folder = build("release", INSTALLED)?;
            for program in ["singletrackd", "singletrack"] {
                println!("{}", folder.join(program).display());
            }
            Ok(())
        }
        [help] if help == "--help" || help == "-h" => {
            print!("{USAGE}");
            Ok(())
        }
        [unknown, ..] => Err(failure!("unexpected argument {unknown:?}\n\n{USAGE}")),
    }
}

/// Checks that the Odroid's programs compute the same bits as this machine: records
/// of the car are replayed here.
pub(crate) fn verify(packages: &Packages) -> Result<(), Failure> {
    let folder = build("release", COMPARED)?;
    let daemon = folder.join("singletrackd");
    for question in ["--version", "--help"] {
        let answer = text(ARMHF.emulated(&daemon).arg(question))?;
        if !answer.contains("singletrackd") {
            return Err(failure!(
                "singletrackd {question}, emulated, does not print its name"
            ));
        }
    }
    let emulated = || ARMHF.emulated(folder.join("examples/trajectory"));
    compare(
        ("this machine", &packages.trajectory()?),
        ("ARMv7", &emulated),
    )
}

/// Builds the daemon and other programs, and returns their folder.
fn build(profile: &str, options: &[&str]) -> Result<PathBuf, Failure> {
    let (mut cargo, folder) = ARMHF.cargo_build(profile)?;
    cargo.args(["--package", "singletrackd"]).args(options);
    check(cargo.stdout(Stdio::null()))?;
    Ok(folder)
}
