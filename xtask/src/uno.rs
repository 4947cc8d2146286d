//! `cargo uno`: builds, checks and flashes the Arduino's image. It and the program that runs it are
//! placed where the simulator searches them: in `uno` in the target folder.

use std::{
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    gates, once, options, prerequisites,
    process::{Result, check, command, failure, require, silent, text},
    target,
    toolchain::{AVR, AVR_CLIPPY, Compiler},
    workspace::{cargo, root},
};

pub(crate) const USAGE: &str = "\
usage: cargo uno [--car-id N] [--flash PORT]

Build the image for the Arduino UNO, run it in simavr, and print its use of flash,
SRAM and processor. Fails if a budget is exceeded. Installs missing Debian
packages.

  --car-id N     the car that it is for, 1 to 65535; its configuration names the same
  --flash PORT   then write it to the UNO at PORT, such as /dev/ttyACM0
  -h, --help     print this help
";

/// What to build.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Options {
    car_id: Option<u16>,
    flash: Option<PathBuf>,
}

pub(crate) fn main(arguments: &[String]) -> Result {
    let options = parse(arguments)?;
    if let Some(port) = &options.flash {
        // Before the build, which takes minutes.
        check_port(port)?;
    }
    let car_id = options.car_id.unwrap_or(0);
    let programmer = options.flash.as_ref().map(|_| "flash");
    let image = ensure(car_id, programmer.as_slice())?;
    let mut figures = cargo("run --package singletrack-sim --bin uno-figures");
    check_image(&image, car_id, &mut figures)?;
    match options.flash {
        Some(port) => flash(&image.join(IMAGE), &port),
        None => Ok(()),
    }
}

pub(crate) fn parse(arguments: &[String]) -> Result<Options> {
    let refused = |reason: &str| Err(failure!("{reason}\n\n{USAGE}"));
    let mut found = Options::default();
    for option in options(arguments, &["--flash", "--car-id"]) {
        match option {
            ("--flash", None | Some("")) => {
                return refused("--flash needs the UNO's port, such as /dev/ttyACM0");
            }
            ("--flash", Some(port)) if found.flash.is_none() => found.flash = Some(port.into()),
            ("--car-id", value) if found.car_id.is_none() => {
                let value = value.unwrap_or_default();
                found.car_id = value.parse().ok().filter(|number| *number > 0);
                if found.car_id.is_none() {
                    let wanted = "--car-id needs a number from 1 to 65535";
                    return refused(&format!("{wanted}, not {value:?}"));
                }
            }
            (option, _) => return refused(&format!("unexpected argument {option:?}")),
        }
    }
    Ok(found)
}

/// The variable with the car's number, which the image's source reads.
const CAR_ID: &str = "SINGLETRACK_CAR_ID";

/// The image to flash, in the folder `uno`.
pub(crate) const IMAGE: &str = "singletrack-uno.elf";

/// The benchmark for the simulator, likewise.
const CYCLES: &str = "singletrack-uno-cycles.elf";

/// Cargo's option for builds on the way to something else: progress is shown on a terminal only.
pub(crate) fn quiet() -> Option<&'static str> {
    (!io::stderr().is_terminal()).then_some("--quiet")
}

/// Installs the prerequisites of the image and others, builds simulator and image, for this car or
/// for none (zero), and places them. Returns their folder.
pub(crate) fn ensure(car_id: u16, others: &[&str]) -> Result<PathBuf> {
    prerequisites::ensure([&["image"], others].concat())?;
    build(car_id, || {
        let mut build = cargo("build --package singletrack-simavr-process");
        check(build.args(quiet()).stdout(Stdio::null()))
    })
}

/// Builds the image and the simulator, and places both. Returns their folder.
pub(crate) fn build(car_id: u16, build_simulator: impl FnOnce() -> Result) -> Result<PathBuf> {
    let target = target::folder()?;
    let mut build = image_build(&Compiler::find(AVR)?, &target);
    build.args(quiet()).env(CAR_ID, car_id.to_string());
    check(build.stdout(Stdio::null()))?;
    build_simulator()?;
    let folder = target.join("uno");
    let built = target.join("uno-build/avr-none/release");
    for image in [IMAGE, CYCLES] {
        target::put(&built.join(image), &folder.join(image))?;
    }
    let simulator = "singletrack-simavr";
    target::put(
        &target.join("debug").join(simulator),
        &folder.join(simulator),
    )?;
    Ok(folder)
}

/// Checks that the image builds without warnings of compiler, clippy and rustdoc.
pub(crate) fn lint() -> Result {
    let compiler = Compiler::find(AVR_CLIPPY)?;
    let mut build = image_build(&compiler, &target::folder()?);
    once::wrap(&mut build, &compiler.clippy())?;
    // RUSTFLAGS would replace the image's own flags.
    check(build.args(["-Zwarnings", "--config", "build.warnings=\"deny\""]))
}

/// The image's crate, which is not a member of the workspace.
pub(crate) fn folder() -> PathBuf {
    root().join("firmware/uno")
}

/// `cargo build` for the image, whose `.cargo/config.toml` has the other options.
fn image_build(compiler: &Compiler, target: &Path) -> Command {
    let mut cargo = compiler.cargo(&folder());
    cargo
        // Suppresses the warning that AVR's linker does not support -no-pie.
        .env("RUSTC_LOG", "error")
        .env(CAR_ID, "0")
        .args(["build", "--release", "--locked", "--target-dir"])
        .arg(target.join("uno-build"));
    cargo
}

/// Checks the image for a car, in its folder, against its budgets, with the measuring program.
pub(crate) fn check_image(folder: &Path, car_id: u16, measure: &mut Command) -> Result {
    let elf = folder.join(IMAGE);
    gates::refuse_forbidden(&elf)?;
    gates::refuse_forbidden(&folder.join(CYCLES))?;
    let size = gates::size(&elf)?;
    // This image, not one named by the environment.
    let measured = text(measure.env("SINGLETRACK_UNO", folder))?;
    let (table, wrong) = gates::judge(size, car_id, &measured)?;
    println!("\n{}\n\n{table}", elf.display());
    require!(wrong.is_empty(), "{}", wrong.join("; "));
    Ok(())
}

/// The package's program that writes an image to an UNO. What it says about a port is clearer than what
/// avrdude does.
fn flasher() -> Command {
    Command::new(root().join("packaging/debian/singletrack-flash"))
}

fn check_port(port: &Path) -> Result {
    silent(flasher().arg("--check").arg(port))
}

/// Writes the image to the board's flash and verifies it.
fn flash(elf: &Path, port: &Path) -> Result {
    let hex = elf.with_extension("hex");
    check(command("avr-objcopy -O ihex -R .eeprom").args([elf, &hex]))?;
    check(flasher().args([port, &hex]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Options> {
        let words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        parse(&words)
    }

    #[test]
    fn options_have_two_forms() {
        for (line, car_id, flash) in [
            ("--flash /dev/ttyACM0", None, Some("/dev/ttyACM0")),
            ("--flash=/dev/ttyACM0", None, Some("/dev/ttyACM0")),
            ("--car-id 7", Some(7), None),
            ("--car-id=7", Some(7), None),
            (
                "--flash /dev/a --car-id 65535",
                Some(u16::MAX),
                Some("/dev/a"),
            ),
        ] {
            let flash = flash.map(PathBuf::from);
            assert_eq!(parsed(line).unwrap(), Options { car_id, flash }, "{line}");
        }
        assert_eq!(parse(&[]).unwrap(), Options::default());
    }

    #[test]
    fn unexpected_arguments_are_refused_with_the_usage() {
        for line in [
            "--flsh /dev/ttyACM0",
            "--flash",
            "--flash=",
            "--flash ",
            "--flash /dev/ttyACM0 again",
            "--flash /dev/a --flash /dev/b",
            "--help me",
            "--car-id",
            "--car-id 0",
            "--car-id 65536",
            "--car-id seven",
            "--car-id 7 --car-id 8",
        ] {
            let error = parsed(line).unwrap_err().to_string();
            assert!(error.contains(USAGE), "{error}");
        }
    }

    #[test]
    fn an_invalid_port_is_refused_before_the_build() {
        assert!(check_port(Path::new("/dev/no-such-port")).is_err());
        assert!(check_port(Path::new("/")).is_err());
    }
}
