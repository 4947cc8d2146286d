//! Daemon and tools for the Odroid XU4: 32-bit ARM, hard float, as Debian calls armhf.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    compiler::{self, ARM},
    cross_cargo::cross_cargo,
    machine::Machine,
    prerequisites,
    process::{Failure, check, output},
    release::Release,
    same_bits, target,
    workspace::root,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Builds singletrackd and singletrack for the Odroid and prints where they are.
Installs the Debian packages that are missing.
";

const TARGET: &str = "armv7-unknown-linux-gnueabihf";
const COMPILER: &str = "arm-linux-gnueabihf-gcc";

/// Runs programs for the Odroid here, with the C library that Debian has for them.
pub(crate) const EMULATOR: &str = "qemu-arm-static";
pub(crate) const EMULATOR_OPTIONS: [&str; 2] = ["-L", "/usr/arm-linux-gnueabihf"];

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match arguments {
        [] => {
            prerequisites::ensure(&Machine::this(), &prerequisites::ODROID, &mut |found| {
                eprintln!("{found}");
            })?;
            let folder = build(Programs::AsInstalled)?;
            for program in ["singletrackd", "singletrack"] {
                println!("{}", folder.join(program).display());
            }
            Ok(())
        }
        [help] if help == "--help" || help == "-h" => {
            print!("{USAGE}");
            Ok(())
        }
        [unknown, ..] => Err(Failure::new(format!(
            "{unknown:?} makes no sense here\n\n{USAGE}"
        ))),
    }
}

/// The Odroid computes what this machine computes, to the bit: a record made on
/// the car is replayed here.
pub(crate) fn verify(release: Release) -> Result<(), Failure> {
    let folder = build(Programs::AsCompared)?;
    let daemon = folder.join("singletrackd");
    for question in ["--version", "--help"] {
        let answer = output(emulated(&daemon).arg(question))?;
        if !String::from_utf8_lossy(&answer).contains("singletrackd") {
            return Err(Failure::new(format!(
                "singletrackd {question}, emulated, does not say who it is"
            )));
        }
    }
    for scenario in same_bits::SCENARIOS {
        same_bits::compare(
            scenario,
            ("this machine", &mut same_bits::simulate(release, scenario)?),
            (
                "ARMv7",
                emulated(&folder.join("singletrack")).args(["simulate", scenario]),
            ),
        )?;
    }
    Ok(())
}

/// What is built of the two programs.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Programs {
    /// Everything.
    AsInstalled,
    /// Neither live view nor figures: they take most of the time, and nothing of theirs is
    /// compared.
    AsCompared,
}

impl Programs {
    fn profile(self) -> &'static [&'static str] {
        match self {
            // It is not debugged here, and that is a third of the time.
            Self::AsInstalled => &["--release", "--config", "profile.release.debug=false"],
            Self::AsCompared => &[
                "--profile",
                "compared",
                // What is built with these features is linted nowhere else.
                "-Zwarnings",
                "--config",
                "build.warnings=\"deny\"",
            ],
        }
    }

    fn folder(self) -> &'static str {
        match self {
            Self::AsInstalled => "release",
            Self::AsCompared => "compared",
        }
    }
}

/// Builds both programs and returns the folder that they are in.
fn build(programs: Programs) -> Result<PathBuf, Failure> {
    let compiler = compiler::find(&Machine::this(), ARM)
        .map_err(|reasons| Failure::new(reasons.join("\n")))?;
    let target = target::folder()?.join("odroid");
    check(
        cross_cargo(&compiler, root())
            .env(
                "CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_LINKER",
                COMPILER,
            )
            // zstd is C.
            .env("CC_armv7_unknown_linux_gnueabihf", COMPILER)
            .args(["build", "--locked"])
            .args(programs.profile())
            .args([
                "-Zbuild-std=std,panic_unwind",
                "--target",
                TARGET,
                "--target-dir",
            ])
            .arg(&target)
            .args(["--package", "singletrackd", "--package", "singletrack"])
            .args((programs == Programs::AsCompared).then_some("--no-default-features"))
            .stdout(Stdio::null()),
    )?;
    Ok(target.join(TARGET).join(programs.folder()))
}

/// A program for the Odroid, on this machine.
fn emulated(program: &Path) -> Command {
    let mut command = Command::new(EMULATOR);
    command
        .current_dir(root())
        .args(EMULATOR_OPTIONS)
        .arg(program);
    command
}
