//! `cargo uno`: builds, checks and flashes the Arduino's image.

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
usage: cargo uno [--car-id N] [--flash PORT]

Build the image for the Arduino UNO, run it in simavr, and print its use of flash,
SRAM and processor. Fails if a budget is exceeded. Installs missing Debian
packages.

  --car-id N     the car that it is for, 1 to 65535; its configuration names the same
  --flash PORT   then write it to the UNO at PORT, such as /dev/ttyACM0
  -h, --help     print this help
";

/// The requested action.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum UnoCommand {
    Help,
    Build {
        /// Zero for none.
        car_id: u16,
        flash: Option<PathBuf>,
    },
}

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    match parse(arguments)? {
        UnoCommand::Help => {
            print!("{USAGE}");
            Ok(())
        }
        UnoCommand::Build {
            car_id,
            flash: port,
        } => {
            if let Some(port) = &port {
                // Before the build, which takes minutes.
                check_port(port)?;
                let required = [&[prerequisites::PROGRAMMER][..], &prerequisites::IMAGE].concat();
                prerequisites::ensure(&Machine::this(), &required, &mut |_| {})?;
            }
            let image = build_and_check(car_id)?;
            port.map_or(Ok(()), |port| flash(&image.elf, &port))
        }
    }
}

pub(crate) fn parse(arguments: &[String]) -> Result<UnoCommand, Failure> {
    let refused = |reason: String| Err(Failure::new(format!("{reason}\n\n{USAGE}")));
    let (mut car_id, mut flash) = (None, None);
    let mut arguments = arguments.iter().map(String::as_str);
    while let Some(argument) = arguments.next() {
        let (name, value) = match argument.split_once('=') {
            Some((name, value)) => (name, Some(value)),
            None => (argument, None),
        };
        match name {
            "--help" | "-h" if argument == name && car_id.is_none() && flash.is_none() => {
                return match arguments.next() {
                    None => Ok(UnoCommand::Help),
                    Some(more) => refused(format!("unexpected argument {more:?}")),
                };
            }
            "--flash" if flash.is_none() => {
                match value.or_else(|| arguments.next()).unwrap_or_default() {
                    "" => {
                        return refused(
                            "--flash needs the UNO's port, such as /dev/ttyACM0".to_owned(),
                        );
                    }
                    port => flash = Some(PathBuf::from(port)),
                }
            }
            "--car-id" if car_id.is_none() => {
                let value = value.or_else(|| arguments.next()).unwrap_or_default();
                match value.parse() {
                    Ok(number @ 1_u16..) => car_id = Some(number),
                    _ => {
                        return refused(format!(
                            "--car-id needs a number from 1 to 65535, not {value:?}"
                        ));
                    }
                }
            }
            _ => return refused(format!("unexpected argument {argument:?}")),
        }
    }
    Ok(UnoCommand::Build {
        car_id: car_id.unwrap_or(0),
        flash,
    })
}

/// Builds image and simulator, and checks the image against its budgets.
fn build_and_check(car_id: u16) -> Result<Image, Failure> {
    let image = image::ensure(Progress::Shown, car_id)?;
    let mut figures = cargo();
    figures
        .args(["run", "--release", "--package", "singletrack-sim"])
        .args(["--bin", "uno-figures"]);
    check_image(&image, car_id, &mut figures)?;
    Ok(image)
}

/// Checks the image for a car against its budgets, with the measuring program.
pub(crate) fn check_image(
    image: &Image,
    car_id: u16,
    measure: &mut Command,
) -> Result<(), Failure> {
    for elf in [&image.elf, &image.cycles_elf] {
        gates::refuse_forbidden(elf)?;
    }
    let size = gates::size(&image.elf)?;
    let measured = output(
        // This image, not one named by the environment.
        measure.env("SINGLETRACK_UNO", &image.folder),
    )?;
    let table = figures::table(size, &String::from_utf8_lossy(&measured))?;
    println!("\n{}\n\n{}", image.elf.display(), figures::render(&table));
    figures::check_car(&table, car_id)?;
    figures::check(&table)
}

/// Checks the port early, with clearer messages than avrdude's.
fn check_port(port: &Path) -> Result<(), Failure> {
    let name = port.display();
    let metadata = fs::metadata(port).map_err(|error| {
        Failure::new(format!(
            "{name}: {error}. Is the UNO plugged in? `ls /dev/serial/by-id /dev/ttyACM* \
             /dev/ttyUSB*` lists the ports"
        ))
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(Failure::new(format!("{name} is not a serial port")));
    }
    // Opening it would reset the board.
    let port = port.as_os_str();
    let may_use = Command::new("test")
        .args(["-r".as_ref(), port, "-a".as_ref(), "-w".as_ref(), port])
        .status();
    // Without this program, avrdude reports the error.
    if may_use.is_ok_and(|status| !status.success()) {
        return Err(Failure::new(format!(
            "no permission for {name}: add yourself to the group that owns it, `sudo usermod \
             --append --groups dialout $USER`, and log in again"
        )));
    }
    Ok(())
}

/// Writes the image to the board's flash and verifies it.
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

    fn parsed(arguments: &[&str]) -> Result<UnoCommand, Failure> {
        parse(
            &arguments
                .iter()
                .map(|&argument| argument.to_owned())
                .collect::<Vec<_>>(),
        )
    }

    #[test]
    fn the_port_has_two_forms() {
        for arguments in [&["--flash", "/dev/ttyACM0"][..], &["--flash=/dev/ttyACM0"]] {
            assert_eq!(
                parsed(arguments).unwrap(),
                UnoCommand::Build {
                    car_id: 0,
                    flash: Some("/dev/ttyACM0".into())
                }
            );
        }
    }

    #[test]
    fn the_cars_number_goes_with_and_without_a_port() {
        for arguments in [&["--car-id", "7"][..], &["--car-id=7"]] {
            assert_eq!(
                parsed(arguments).unwrap(),
                UnoCommand::Build {
                    car_id: 7,
                    flash: None
                }
            );
        }
        assert_eq!(
            parsed(&["--flash", "/dev/ttyACM0", "--car-id", "65535"]).unwrap(),
            UnoCommand::Build {
                car_id: u16::MAX,
                flash: Some("/dev/ttyACM0".into())
            }
        );
    }

    #[test]
    fn unexpected_arguments_are_refused_with_the_usage() {
        for arguments in [
            &["--flsh", "/dev/ttyACM0"][..],
            &["--flash"],
            &["--flash="],
            &["--flash", ""],
            &["--flash", "/dev/ttyACM0", "again"],
            &["--help", "me"],
            &["--car-id"],
            &["--car-id", "0"],
            &["--car-id", "65536"],
            &["--car-id", "seven"],
            &["--car-id", "7", "--car-id", "8"],
        ] {
            let error = parsed(arguments).unwrap_err().to_string();
            assert!(error.contains(USAGE), "{error}");
        }
    }

    #[test]
    fn an_invalid_port_is_refused_before_the_build() {
        assert!(check_port(Path::new("/dev/no-such-port")).is_err());
        assert!(check_port(Path::new("/")).is_err());
    }
}
