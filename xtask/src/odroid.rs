//! Daemon and tools for the Odroid XU4: 32-bit ARM with hard float (Debian's armhf).

use std::{path::PathBuf, process::Stdio};

use crate::{
    foreign::ARMHF,
    machine::Machine,
    prerequisites,
    process::{Failure, check, output},
    release::Release,
    same_bits,
};

pub(crate) const USAGE: &str = "\
usage: cargo odroid

Build singletrackd and singletrack for the Odroid and print their paths.
Installs missing Debian packages.
";

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
            "unexpected argument {unknown:?}\n\n{USAGE}"
        ))),
    }
}

/// Checks that the Odroid's programs compute the same bits as this machine: records
/// of the car are replayed here.
pub(crate) fn verify(release: Release) -> Result<(), Failure> {
    let folder = build(Programs::AsCompared)?;
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
        same_bits::compare(
            scenario,
            ("this machine", &mut same_bits::simulate(release, scenario)?),
            (
                "ARMv7",
                ARMHF
                    .emulated(folder.join("singletrack"))
                    .args(["simulate", scenario]),
            ),
        )?;
    }
    Ok(())
}

/// Variants of the two programs.
#[derive(Clone, Copy)]
enum Programs {
    /// Without the commands that reproduce the paper, which are not for the car.
    AsInstalled,
    /// Also without the live view and the demo, which take most of the build time and are
    /// not compared.
    AsCompared,
}

impl Programs {
    fn profile(self) -> &'static [&'static str] {
        match self {
            Self::AsInstalled => &["--release"],
            Self::AsCompared => &[
                "--profile",
                "compared",
                // This combination of features is linted only here.
                "-Zwarnings",
                "--config",
                "build.warnings=\"deny\"",
            ],
        }
    }

    fn features(self) -> &'static [&'static str] {
        match self {
            Self::AsInstalled => &[
                "--features",
                "singletrack/desk,singletrack/live,singletrack/page,singletrackd/live,singletrackd/page",
            ],
            Self::AsCompared => &[],
        }
    }

    fn folder(self) -> &'static str {
        match self {
            Self::AsInstalled => "release",
            Self::AsCompared => "compared",
        }
    }
}

/// Builds both programs and returns their folder.
fn build(programs: Programs) -> Result<PathBuf, Failure> {
    let (mut cargo, target) = ARMHF.cargo_build()?;
    check(
        cargo
            .args(programs.profile())
            .args(["--package", "singletrackd", "--package", "singletrack"])
            .arg("--no-default-features")
            .args(programs.features())
            .stdout(Stdio::null()),
    )?;
    Ok(ARMHF.programs(&target, programs.folder()))
}
