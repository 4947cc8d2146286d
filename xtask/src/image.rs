//! Builds the Arduino's image and the program that runs it, and places them where
//! the simulator searches: in `uno` in the target folder.

use std::{
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    compiler::{self, AVR, Compiler},
    cross_cargo::cross_cargo,
    machine::Machine,
    prerequisites,
    process::{Failure, check},
    target,
    workspace::{cargo, root},
};

/// Verbosity of the builds.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Cargo's default.
    Shown,
    /// Warnings and errors only.
    Quiet,
}

impl Progress {
    /// Progress is shown on a terminal only.
    pub(crate) fn of_stderr() -> Self {
        if io::stderr().is_terminal() {
            Self::Shown
        } else {
            Self::Quiet
        }
    }

    /// Cargo's option for it.
    pub(crate) fn option(self) -> Option<&'static str> {
        (self == Self::Quiet).then_some("--quiet")
    }
}

/// The variable with the car's number, which the image's source reads.
const CAR_ID: &str = "SINGLETRACK_CAR_ID";

/// Paths of the image.
pub(crate) struct Image {
    /// Folder of all files.
    pub(crate) folder: PathBuf,
    /// The image to flash.
    pub(crate) elf: PathBuf,
    /// The benchmark for the simulator.
    pub(crate) cycles_elf: PathBuf,
}

/// Installs the prerequisites, builds simulator and image, for this car or for none (zero),
/// and places them.
pub(crate) fn ensure(progress: Progress, car_id: u16) -> Result<Image, Failure> {
    let machine = Machine::this();
    prerequisites::ensure(&machine, &prerequisites::IMAGE, &mut |found| {
        if progress == Progress::Shown {
            eprintln!("{found}");
        }
    })?;
    build(progress, car_id, || {
        check(
            cargo()
                .args(["build", "--release", "--package", "singletrack-simavr"])
                .args(["--features", "simavr"])
                .args(progress.option())
                .stdout(Stdio::null()),
        )
    })
}

/// Builds the image and the simulator, and places both.
pub(crate) fn build(
    progress: Progress,
    car_id: u16,
    build_simulator: impl FnOnce() -> Result<(), Failure>,
) -> Result<Image, Failure> {
    let target = target::folder()?;
    let build = build_folder(&target);
    check(
        uno_cargo(&compiler()?, "build", &build)
            .args(progress.option())
            .env(CAR_ID, car_id.to_string())
            .stdout(Stdio::null()),
    )?;
    build_simulator()?;

    let built = build.join("avr-none/release");
    let folder = target.join("uno");
    let image = Image {
        elf: folder.join("singletrack-uno.elf"),
        cycles_elf: folder.join("singletrack-uno-cycles.elf"),
        folder,
    };
    target::put(&built.join("singletrack-uno.elf"), &image.elf)?;
    target::put(&built.join("singletrack-uno-cycles.elf"), &image.cycles_elf)?;
    target::put(
        &target.join("release/singletrack-simavr"),
        &image.folder.join("singletrack-simavr"),
    )?;
    Ok(image)
}

/// The compiler of the image.
fn compiler() -> Result<Compiler, Failure> {
    compiler::find(&Machine::this(), AVR).map_err(|reasons| Failure::new(reasons.join("\n")))
}

/// Checks that the image builds without warnings of compiler and clippy.
pub(crate) fn lint() -> Result<(), Failure> {
    let compiler = compiler()?;
    let clippy = compiler.clippy(&Machine::this()).map_err(Failure::new)?;
    let build = build_folder(&target::folder()?);
    // RUSTFLAGS would replace the image's own flags.
    let deny = ["-Zwarnings", "--config", "build.warnings=\"deny\""];
    check(uno_cargo(&compiler, "build", &build).args(deny))?;
    check(
        uno_cargo(&compiler, "check", &build)
            .args(deny)
            .env("RUSTC_WORKSPACE_WRAPPER", clippy),
    )
}

/// The image's crate, which is not a member of the workspace.
pub(crate) fn folder() -> PathBuf {
    root().join("firmware/uno")
}

fn build_folder(target: &Path) -> PathBuf {
    target.join("uno-build")
}

/// The common part of all commands. The image's `.cargo/config.toml` has the other
/// options.
fn uno_cargo(compiler: &Compiler, command: &str, target: &Path) -> Command {
    let mut cargo = cross_cargo(compiler, &folder());
    cargo
        // Suppresses the warning that AVR's linker does not support -no-pie.
        .env("RUSTC_LOG", "error")
        .env(CAR_ID, "0")
        .args([command, "--release", "--locked", "--target-dir"])
        .arg(target);
    cargo
}
