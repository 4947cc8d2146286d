//! `cargo uno`: builds the Arduino's image, checks it, flashes it.

use std::{
    fs,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    figures, gates,
    image::{self, Image, Progress},
    machine::Machine,
    prerequisites,
    process::{Failure, check, output},
    workspace::cargo,
};

pub(crate) const USAGE: &str = "\
usage: cargo uno [--flash PORT]

Builds the image for the Arduino UNO, runs it in simavr, and says what it takes
of flash, SRAM and processor. Fails when that is more than its budget. Installs
the Debian packages that are missing.

  --flash PORT   then writes it to the UNO at PORT, such as /dev/ttyACM0
  -h, --help     says this
";

/// What is asked for.
#[derive(Debug, PartialEq, Eq)]
enum Asked {
    Help,
    Check,
    Flash(PathBuf),
}

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match parse(arguments)? {
        Asked::Help => {
            print!("{USAGE}");
            Ok(())
        }
        Asked::Check => build_and_check().map(drop),
        Asked::Flash(port) => {
            // Before the minutes of building.
            look_at(&port)?;
            let wanted = [&[prerequisites::PROGRAMMER][..], &prerequisites::IMAGE].concat();
            prerequisites::ensure(&Machine::this(), &wanted, &mut |_| {})?;
            flash(&build_and_check()?.elf, &port)
        }
    }
}

fn parse(arguments: &[String]) -> Result<Asked, Failure> {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        [] => Ok(Asked::Check),
        ["--help" | "-h"] => Ok(Asked::Help),
        ["--flash", port] if !port.is_empty() => Ok(Asked::Flash(port.into())),
        ["--flash"] => Err(Failure::new(format!(
            "--flash needs the UNO's port, such as /dev/ttyACM0\n\n{USAGE}"
        ))),
        [argument] if argument.starts_with("--flash=") => parse(&[
            "--flash".to_owned(),
            argument["--flash=".len()..].to_owned(),
        ]),
        [unknown, ..] => Err(Failure::new(format!(
            "{unknown:?} makes no sense here\n\n{USAGE}"
        ))),
    }
}

/// Builds image and simulator, and checks the image against its budgets.
fn build_and_check() -> Result<Image, Failure> {
    let image = image::ensure(Progress::Shown)?;
    let mut figures = cargo();
    figures
        .args(["run", "--release", "--package", "singletrack-sim"])
        .args(["--bin", "uno-figures"]);
    check_image(&image, &mut figures)?;
    Ok(image)
}

/// Checks an image against its budgets, with the program that measures it.
pub(crate) fn check_image(image: &Image, measure: &mut Command) -> Result<(), Failure> {
    for elf in [&image.elf, &image.cycles_elf] {
        gates::refuse_forbidden(elf)?;
    }
    let size = gates::size(&image.elf)?;
    let measured = output(
        // This image, and none that the environment names.
        measure.env("SINGLETRACK_UNO", &image.folder),
    )?;
    let table = figures::table(size, &String::from_utf8_lossy(&measured))?;
    println!("\n{}\n\n{}", image.elf.display(), figures::render(&table));
    figures::check(&table)
}

/// Says early what avrdude would say late and less clearly.
fn look_at(port: &Path) -> Result<(), Failure> {
    let name = port.display();
    let metadata = fs::metadata(port).map_err(|error| {
        Failure::new(format!(
            "{name}: {error}. Is the UNO plugged in? `ls /dev/serial/by-id /dev/ttyACM* \
             /dev/ttyUSB*` lists what there is"
        ))
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(Failure::new(format!("{name} is no serial port")));
    }
    // Opening it would reset the board.
    let port = port.as_os_str();
    let may_use = Command::new("test")
        .args(["-r".as_ref(), port, "-a".as_ref(), "-w".as_ref(), port])
        .status();
    // Where there is no such program, avrdude will tell.
    if may_use.is_ok_and(|status| !status.success()) {
        return Err(Failure::new(format!(
            "you may not use {name}: become a member of the group that owns it, `sudo usermod \
             --append --groups dialout $USER`, and log in again"
        )));
    }
    Ok(())
}

/// Writes the image into the board's flash and reads it back.
fn flash(elf: &Path, port: &Path) -> Result<(), Failure> {
    let hex = elf.with_extension("hex");
    check(
        Command::new("avr-objcopy")
            .args(["-O", "ihex", "-R", ".eeprom"])
            .args([elf, &hex]),
    )?;
    let mut write = std::ffi::OsString::from("flash:w:");
    write.push(&hex);
    write.push(":i");
    check(
        Command::new("avrdude")
            .args([
                "-p",
                "atmega328p",
                "-c",
                "arduino",
                "-b",
                "115200",
                "-D",
                "-P",
            ])
            .arg(port)
            .arg("-U")
            .arg(write)
            .stdin(Stdio::null()),
    )
    .map_err(|failure| {
        Failure::new(format!(
            "{failure}. Does another program have {} open, the daemon perhaps? Is it an UNO with \
             its bootloader?",
            port.display()
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(arguments: &[&str]) -> Result<Asked, Failure> {
        parse(
            &arguments
                .iter()
                .map(|&argument| argument.to_owned())
                .collect::<Vec<_>>(),
        )
    }

    #[test]
    fn a_port_is_given_in_either_form() {
        for arguments in [&["--flash", "/dev/ttyACM0"][..], &["--flash=/dev/ttyACM0"]] {
            assert_eq!(
                parsed(arguments).unwrap(),
                Asked::Flash("/dev/ttyACM0".into())
            );
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_the_usage() {
        for arguments in [
            &["--flsh", "/dev/ttyACM0"][..],
            &["--flash"],
            &["--flash="],
            &["--flash", ""],
            &["--flash", "/dev/ttyACM0", "again"],
            &["--help", "me"],
        ] {
            let error = parsed(arguments).unwrap_err().to_string();
            assert!(error.contains(USAGE), "{error}");
        }
    }

    #[test]
    fn a_port_that_is_no_port_is_refused_before_anything_is_built() {
        assert!(look_at(Path::new("/dev/no-such-port")).is_err());
        assert!(look_at(Path::new("/")).is_err());
    }
}
