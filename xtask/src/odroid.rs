//! Daemon and tools for the Odroid XU4: 32-bit ARM with hard float (Debian's armhf).

use std::{path::PathBuf, process::Stdio};

use crate::{
    prerequisites,
    process::{Failure, check, output},
    release::Release,
    same_bits,
    toolchain::ARMHF,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Build singletrackd and singletrack for the Odroid and print their paths.
Installs missing Debian packages.
";

/// Without the commands that reproduce the paper, which are not for the car.
const AS_INSTALLED: &[&str] = &[
    "--features",
    "singletrack/desk,singletrack/live,singletrack/page,singletrackd/live,singletrackd/page",
];

/// Also without the live view and the demo, which take most of the build time and are not compared.
/// This combination of features is linted only here.
const AS_COMPARED: &[&str] = &["-Zwarnings", "--config", "build.warnings=\"deny\""];

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match arguments {
        [] => {
            prerequisites::ensure(&prerequisites::ODROID)?;
            let folder = build("release", AS_INSTALLED)?;
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
            "unexpected argument {unknown:?}\n\n{USAGE}"
        ))),
    }
}

/// Checks that the Odroid's programs compute the same bits as this machine: records
/// of the car are replayed here.
pub(crate) fn verify(release: Release) -> Result<(), Failure> {
    let folder = build("compared", AS_COMPARED)?;
    let daemon = folder.join("singletrackd");
    for question in ["--version", "--help"] {
        let answer = output(ARMHF.emulated(&daemon).arg(question))?;
        if !String::from_utf8_lossy(&answer).contains("singletrackd") {
            return Err(Failure::new(format!(
                "singletrackd {question}, emulated, does not print its name"
            )));
        }
    }
    for scenario in same_bits::SCENARIOS {
        let mut emulated = ARMHF.emulated(folder.join("singletrack"));
        same_bits::compare(
            scenario,
            ("this machine", &mut same_bits::simulate(release, scenario)?),
            ("ARMv7", emulated.args(["simulate", scenario])),
        )?;
    }
    Ok(())
}

/// Builds both programs and returns their folder.
fn build(profile: &str, options: &[&str]) -> Result<PathBuf, Failure> {
    let (mut cargo, folder) = ARMHF.cargo_build(profile)?;
    check(
        cargo
            .args(["--package", "singletrackd", "--package", "singletrack"])
            .arg("--no-default-features")
            .args(options)
            .stdout(Stdio::null()),
    )?;
    Ok(folder)
}
