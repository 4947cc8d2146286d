//! `cargo verify`: every check of the project, on a machine that has nothing
//! but a Rust toolchain and a C compiler.

mod packages;
mod same_bits;
mod step;

use std::{path::PathBuf, process::ExitCode};

use step::{Failure, Step, run_all};

const USAGE: &str = "\
usage: cargo verify [STEP...]

Runs every check of the project, or the steps named. Says what it runs and how
long each step took, and stops at the first that fails.
";

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let chosen: Vec<String> = match arguments.next().as_deref() {
        Some("verify") => arguments.collect(),
        _ => {
            eprint!("{USAGE}");
            return ExitCode::FAILURE;
        }
    };
    let steps = steps();
    if chosen.iter().any(|name| name == "--help" || name == "-h") {
        print!("{USAGE}\nSteps:\n");
        for step in &steps {
            println!("  {:14} {}", step.name, step.what);
        }
        return ExitCode::SUCCESS;
    }
    match run_all(&steps, &chosen) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\nverify: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// The checks, in order: the quick ones first.
fn steps() -> Vec<Step> {
    vec![
        Step::new(
            "prerequisites",
            "rustfmt, clippy and a C compiler",
            prerequisites,
        ),
        Step::cargo(
            "format",
            "the code is formatted",
            &["fmt", "--all", "--check"],
        ),
        Step::cargo(
            "lints",
            "no warning from compiler or clippy",
            &[
                "clippy",
                "--workspace",
                "--all-targets",
                "--",
                "-D",
                "warnings",
            ],
        ),
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
        Step::cargo(
            "tests",
            "unit, property and virtual-time tests",
            &["test", "--workspace", "--exclude", "singletrack-hil"],
        ),
        Step::new(
            "same-bits",
            "debug and release builds simulate the same bits",
            same_bits::check,
        ),
        Step::cargo(
            "hardware-in-the-loop",
            "the shipped daemon against the simulator, in real time",
            // One at a time: each needs the machine to itself.
            &[
                "test",
                "--release",
                "--package",
                "singletrack-hil",
                "--",
                "--test-threads=1",
            ],
        ),
    ]
}

/// Names what is missing and how to get it, before anything else fails over it.
fn prerequisites() -> Result<(), Failure> {
    for (component, arguments) in [
        ("rustfmt", ["fmt", "--version"]),
        ("clippy", ["clippy", "--version"]),
    ] {
        step::quiet(step::cargo().args(arguments)).map_err(|_| {
            Failure::new(format!(
                "cargo {} does not work: install it with `rustup component add {component}`",
                arguments[0]
            ))
        })?;
    }
    let compiler = std::env::var_os("CC").map_or_else(|| PathBuf::from("cc"), PathBuf::from);
    step::quiet(std::process::Command::new(&compiler).arg("--version")).map_err(|_| {
        Failure::new(format!(
            "no C compiler: {} does not run; on Debian, `apt-get install gcc libc6-dev`",
            compiler.display()
        ))
    })
}
