//! Daemon and tools for the Odroid XU4: 32-bit ARM with hard float (Debian's armhf).

use std::{path::PathBuf, process::Stdio};

use crate::{
    prerequisites,
    process::{Failure, check, failure},
    programs::{Packages, TRAJECTORY, compare},
    toolchain::ARMHF,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Build singletrackd and singletrack for the Odroid and print their paths.
Installs missing Debian packages.
";

/// The programs of the car.
const INSTALLED: [&str; 4] = ["--package", "singletrackd", "--package", "singletrack"];

/// The daemon and the operator's commands, as they are installed there. This combination of features
/// is linted only here.
const CHECKED: [&str; 3] = ["-Zwarnings", "--config", "build.warnings=\"deny\""];

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match arguments {
        [] => {
            prerequisites::ensure(&prerequisites::ODROID)?;
            let folder = build("release", &INSTALLED)?;
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

/// Checks that the Odroid's programs compile, and that the tested profile simulates the same bits
/// there as here. The programs themselves are built and run by `cargo deb`.
pub(crate) fn verify(packages: &Packages) -> Result<(), Failure> {
    let (mut check_programs, _) = ARMHF.cargo("check", "dev")?;
    check_programs.args(INSTALLED).args(CHECKED);
    check(&mut check_programs)?;
    compare_bits(packages, "dev")
}

/// Checks that a profile simulates the same bits there as the tests here: records of the car are
/// replayed here.
pub(crate) fn compare_bits(packages: &Packages, profile: &str) -> Result<(), Failure> {
    let folder = build(profile, &TRAJECTORY)?;
    let emulated = || ARMHF.emulated(folder.join("trajectory"));
    compare(
        ("this machine", &packages.trajectory()?),
        ("ARMv7", &emulated),
    )
}

/// Builds programs, and returns their folder.
fn build(profile: &str, options: &[&str]) -> Result<PathBuf, Failure> {
    let (mut cargo, folder) = ARMHF.cargo("build", profile)?;
    check(cargo.args(options).stdout(Stdio::null()))?;
    Ok(folder)
}
