//! Builds the Arduino's image and the program that runs it, and places them where
//! the simulator searches: in `uno` in the target folder.

use std::{
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    prerequisites::{self, AVR_CLIPPY, IMAGE, Prerequisite},
    process::{Failure, check},
    target,
    toolchain::{AVR, Compiler},
    workspace::{cargo, root},
};

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

/// Cargo's option for builds on the way to something else: progress is shown on a terminal only.
pub(crate) fn quiet() -> Option<&'static str> {
    (!io::stderr().is_terminal()).then_some("--quiet")
}

/// Installs the prerequisites of the image and others, builds simulator and image, for this car or
/// for none (zero), and places them.
pub(crate) fn ensure(car_id: u16, others: &[Prerequisite]) -> Result<Image, Failure> {
    prerequisites::ensure(&[&IMAGE, others].concat())?;
    build(car_id, || {
        let mut build = cargo();
        build.args(["build", "--package", "singletrack-simavr-process"]);
        check(build.args(quiet()).stdout(Stdio::null()))
    })
}

/// Builds the image and the simulator, and places both.
pub(crate) fn build(
    car_id: u16,
    build_simulator: impl FnOnce() -> Result<(), Failure>,
) -> Result<Image, Failure> {
    let target = target::folder()?;
    let mut build = uno_cargo(&Compiler::find(AVR)?, "build", &target);
    build.args(quiet()).env(CAR_ID, car_id.to_string());
    check(build.stdout(Stdio::null()))?;
    build_simulator()?;
    let folder = target.join("uno");
    let image = Image {
        elf: folder.join("singletrack-uno.elf"),
        cycles_elf: folder.join("singletrack-uno-cycles.elf"),
        folder,
    };
    let built = target.join("uno-build/avr-none/release");
    target::put(&built.join("singletrack-uno.elf"), &image.elf)?;
    target::put(&built.join("singletrack-uno-cycles.elf"), &image.cycles_elf)?;
    let simulator = target.join("debug/singletrack-simavr");
    target::put(&simulator, &image.folder.join("singletrack-simavr"))?;
    Ok(image)
}

/// Checks that the image builds without warnings of compiler and clippy.
pub(crate) fn lint() -> Result<(), Failure> {
    let compiler = Compiler::find(AVR_CLIPPY)?;
    let target = target::folder()?;
    // RUSTFLAGS would replace the image's own flags.
    let deny = ["-Zwarnings", "--config", "build.warnings=\"deny\""];
    check(uno_cargo(&compiler, "build", &target).args(deny))?;
    let mut clippy = uno_cargo(&compiler, "check", &target);
    clippy.env("RUSTC_WORKSPACE_WRAPPER", compiler.clippy());
    check(clippy.args(deny))
}

/// The image's crate, which is not a member of the workspace.
pub(crate) fn folder() -> PathBuf {
    root().join("firmware/uno")
}

/// The common part of all commands. The image's `.cargo/config.toml` has the other
/// options.
fn uno_cargo(compiler: &Compiler, command: &str, target: &Path) -> Command {
    let mut cargo = compiler.cargo(&folder());
    cargo
        // Suppresses the warning that AVR's linker does not support -no-pie.
        .env("RUSTC_LOG", "error")
        .env(CAR_ID, "0")
        .args([command, "--release", "--locked", "--target-dir"])
        .arg(target.join("uno-build"));
    cargo
}
