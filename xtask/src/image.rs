//! The Arduino's image and the program that runs it, built and put where the
//! simulator looks for them: in `uno` in the target folder.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    debian,
    debian_cargo::debian_cargo,
    step::{Failure, cargo, check, root},
    target,
};

/// How loud the builds are.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// As cargo is.
    Shown,
    /// Warnings and errors only.
    Quiet,
}

/// Where the image is.
pub(crate) struct Image {
    /// The folder of all files.
    pub(crate) folder: PathBuf,
    /// What is flashed.
    pub(crate) elf: PathBuf,
    /// The same with its sections marked for the simulator.
    pub(crate) cycles_elf: PathBuf,
}

/// Installs what it takes, builds image and simulator, puts them in place.
pub(crate) fn ensure(progress: Progress) -> Result<Image, Failure> {
    debian::ensure(&[debian::IMAGE, debian::SIMULATOR])?;
    let target = target::folder()?;
    let build = build_folder(&target);
    let quiet = (progress == Progress::Quiet).then_some("--quiet");
    check(uno_cargo("build", &build).args(quiet).stdout(Stdio::null()))?;
    check(
        cargo()
            // Else it would lie in a folder of that target.
            .env_remove("CARGO_BUILD_TARGET")
            .args(["build", "--release", "--package", "singletrack-simavr"])
            .args(["--features", "simavr"])
            .args(quiet)
            .stdout(Stdio::null()),
    )?;

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

/// Neither compiler nor clippy warns of the image.
pub(crate) fn lint() -> Result<(), Failure> {
    debian::ensure(&[debian::IMAGE, debian::IMAGE_LINTS])?;
    let build = build_folder(&target::folder()?);
    // RUSTFLAGS would replace those that the image is built with.
    let deny = ["-Zwarnings", "--config", "build.warnings=\"deny\""];
    check(uno_cargo("build", &build).args(deny))?;
    check(
        uno_cargo("check", &build)
            .args(deny)
            .env("RUSTC_WORKSPACE_WRAPPER", "/usr/bin/clippy-driver"),
    )
}

/// The image's crate, which is no member of the workspace.
pub(crate) fn folder() -> PathBuf {
    root().join("firmware/uno")
}

fn build_folder(target: &Path) -> PathBuf {
    target.join("uno-build")
}

/// What is the same for every command. The image's `.cargo/config.toml` says
/// everything else.
fn uno_cargo(command: &str, target: &Path) -> Command {
    let mut cargo = debian_cargo(&folder());
    cargo
        // It warns that AVR's linker does not know -no-pie, and does without.
        .env("RUSTC_LOG", "error")
        .args([command, "--release", "--locked", "--target-dir"])
        .arg(target);
    cargo
}
