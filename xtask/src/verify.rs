//! `cargo verify`: every check of the project.

use std::{path::PathBuf, process::Command};

use crate::{
    debian,
    image::{self, Progress},
    odroid, packages, readers, same_bits,
    step::{Failure, Step, cargo, check, quiet, run_all},
    units, uno,
};

pub(crate) const USAGE: &str = "\
usage: cargo verify [STEP...]

Runs every check of the project, or the steps named. Says what it runs and how
long each step took, and stops at the first that fails. Installs the Debian
packages that are missing.
";

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    let steps = steps();
    if arguments
        .iter()
        .any(|name| name == "--help" || name == "-h")
    {
        print!("{USAGE}\nSteps:\n");
        for step in &steps {
            println!("  {:22} {}", step.name, step.what);
        }
        return Ok(());
    }
    run_all(&steps, arguments)
}

/// All tests that take no more time than they need.
pub(crate) const TESTS: [&str; 4] = ["test", "--workspace", "--exclude", "singletrack-hil"];

/// The checks, in order: the quick ones first, those in real time last.
fn steps() -> Vec<Step> {
    [quick_steps(), program_steps(), real_time_steps()]
        .into_iter()
        .flatten()
        .collect()
}

/// What is wrong with the text of the programs.
fn quick_steps() -> Vec<Step> {
    vec![
        Step::new(
            "prerequisites",
            "rustfmt, clippy, a C compiler, and Debian's packages for Arduino, Odroid and service",
            prerequisites,
        ),
        Step::new("format", "the code is formatted", format),
        Step::cargo(
            "lints",
            "no warning from compiler or clippy",
            &[
                "clippy",
                "--workspace",
                "--features",
                "singletrack-simavr/simavr,singletrack-sim/uno",
                "--all-targets",
                "--",
                "-D",
                "warnings",
            ],
        ),
        Step::new("lints-uno", "none in the Arduino's image", image::lint),
        Step::new(
            "packages",
            "each package builds alone, with the features that it asks for itself",
            packages::check_all,
        ),
        Step::cargo(
            "documentation",
            "the documentation builds without a warning",
            &["doc", "--workspace", "--no-deps"],
        )
        .env("RUSTDOCFLAGS", "-D warnings"),
        Step::new(
            "units",
            "systemd takes the service's unit without a word, and finds it hardly exposed",
            units::check,
        ),
    ]
}

/// What is wrong with the programs, in as little time as they take.
fn program_steps() -> Vec<Step> {
    vec![
        Step::new(
            "uno",
            "the Arduino's image contains nothing miscompiled and keeps to its budgets",
            || uno::build_and_check().map(drop),
        ),
        Step::cargo("tests", "unit, property and virtual-time tests", &TESTS),
        Step::cargo(
            "simavr",
            "the simulated Arduino",
            &[
                "test",
                "--release",
                "--package",
                "singletrack-simavr",
                "--features",
                "simavr",
            ],
        ),
        Step::new(
            "same-bits",
            "debug and release builds simulate the same bits",
            same_bits::check,
        ),
        Step::new(
            "readers",
            "others read from a record what we say it holds, and from a recovered one",
            readers::check,
        ),
        Step::new(
            "image",
            "the image does what the board does, under faults too, in virtual time",
            || {
                with_image(&[
                    "test",
                    "--release",
                    "--package",
                    "singletrack-sim",
                    "--features",
                    "uno",
                    "--test",
                    "uno",
                ])
            },
        ),
        Step::cargo(
            "faults",
            "random faults in virtual time break nothing that must hold",
            &[
                "run",
                "--release",
                "--package",
                "singletrack-faults",
                "--",
                "--count",
                "300",
            ],
        ),
        Step::new("faults-uno", "nor with the Arduino's image", || {
            with_image(&[
                "run",
                "--release",
                "--package",
                "singletrack-faults",
                "--",
                "--count",
                "8",
                "--board",
                "uno",
            ])
        }),
        Step::new(
            "odroid",
            "daemon and tools build for the Odroid, and simulate the same bits there",
            odroid::verify,
        ),
    ]
}

/// What only shows in real time. One test at a time: each needs the machine to
/// itself.
fn real_time_steps() -> Vec<Step> {
    vec![
        Step::cargo(
            "hil-native",
            "hardware in the loop: the shipped daemon against the simulated board",
            &[
                "test",
                "--release",
                "--package",
                "singletrack-hil",
                "--test",
                "hil",
                "--",
                "--board",
                "native",
                "--test-threads=1",
            ],
        ),
        Step::new("hil-uno", "the same against the Arduino's image", || {
            with_image(&[
                "test",
                "--release",
                "--package",
                "singletrack-hil",
                "--test",
                "hil",
                "--",
                "--board",
                "uno",
                "--test-threads=1",
            ])
        }),
    ]
}

/// Cargo with the image of this source: chosen alone, a step must not test one
/// that was left behind, nor one that somebody's environment names.
fn with_image(arguments: &[&str]) -> Result<(), Failure> {
    let image = image::ensure(Progress::Quiet)?;
    check(
        cargo()
            .env("SINGLETRACK_UNO", &image.folder)
            .args(arguments),
    )
}

/// Names what is missing and how to get it, or gets it, before anything else
/// fails over it.
fn prerequisites() -> Result<(), Failure> {
    for (component, arguments) in [
        ("rustfmt", ["fmt", "--version"]),
        ("clippy", ["clippy", "--version"]),
    ] {
        quiet(cargo().args(arguments)).map_err(|_| {
            Failure::new(format!(
                "cargo {} does not work: install it with `rustup component add {component}`",
                arguments[0]
            ))
        })?;
    }
    let compiler = std::env::var_os("CC").map_or_else(|| PathBuf::from("cc"), PathBuf::from);
    quiet(Command::new(&compiler).arg("--version")).map_err(|_| {
        Failure::new(format!(
            "no C compiler: {} does not run; on Debian, `apt-get install gcc libc6-dev`",
            compiler.display()
        ))
    })?;
    debian::ensure(&[
        debian::IMAGE,
        debian::IMAGE_LINTS,
        debian::SIMULATOR,
        debian::ODROID,
        debian::UNITS,
    ])
}

/// That of the workspace, and of the image, which is no member of it.
fn format() -> Result<(), Failure> {
    check(cargo().args(["fmt", "--all", "--check"]))?;
    check(
        cargo()
            .current_dir(image::folder())
            .args(["fmt", "--check"]),
    )
}

#[cfg(test)]
mod tests {
    use super::steps;

    #[test]
    fn no_step_runs_an_image_that_it_has_not_built() {
        let names: Vec<&str> = steps()
            .iter()
            .filter(|step| step.arguments().contains(&"uno"))
            .map(|step| step.name)
            .collect();
        assert_eq!(names, [""; 0]);
    }
}
