//! Daemon and tools for the Odroid XU4: 32-bit ARM, hard float, as Debian calls armhf.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    debian,
    debian_cargo::debian_cargo,
    same_bits,
    step::{Failure, check, output, root},
    target,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Builds singletrackd and singletrack for the Odroid and prints where they are.
Installs the Debian packages that are missing.
";

const TARGET: &str = "armv7-unknown-linux-gnueabihf";
const COMPILER: &str = "arm-linux-gnueabihf-gcc";

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match arguments {
        [] => {
            let folder = build()?;
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
pub(crate) fn verify() -> Result<(), Failure> {
    let folder = build()?;
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
            ("this machine", &mut same_bits::simulate(scenario)),
            (
                "ARMv7",
                emulated(&folder.join("singletrack")).args(["simulate", scenario]),
            ),
        )?;
    }
    Ok(())
}

/// Builds both programs and returns the folder that they are in.
fn build() -> Result<PathBuf, Failure> {
    debian::ensure(&[debian::ODROID])?;
    let target = target::folder()?.join("odroid");
    check(
        debian_cargo(&root())
            .env(
                "CARGO_TARGET_ARMV7_UNKNOWN_LINUX_GNUEABIHF_LINKER",
                COMPILER,
            )
            // zstd is C.
            .env("CC_armv7_unknown_linux_gnueabihf", COMPILER)
            .args(["build", "--release", "--locked"])
            // Nobody debugs it here, and it is a third of the time.
            .args(["--config", "profile.release.debug=false"])
            .args([
                "-Zbuild-std=std,panic_unwind",
                "--target",
                TARGET,
                "--target-dir",
            ])
            .arg(&target)
            .args(["--package", "singletrackd", "--package", "singletrack"])
            .stdout(Stdio::null()),
    )?;
    Ok(target.join(TARGET).join("release"))
}

/// A program for the Odroid, on this machine.
fn emulated(program: &Path) -> Command {
    let mut command = Command::new("qemu-arm-static");
    command
        .current_dir(root())
        .env("QEMU_LD_PREFIX", "/usr/arm-linux-gnueabihf")
        .arg(program);
    command
}
