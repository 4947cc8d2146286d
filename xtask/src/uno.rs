//! `cargo uno`: builds, checks and flashes the Arduino's image.

use std::{
    fs,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    gates,
    image::{self, Image},
    prerequisites::PROGRAMMER,
    process::{Failure, check, failure, text},
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

/// What to build.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Options {
    car_id: Option<u16>,
    flash: Option<PathBuf>,
}

pub(crate) fn main(arguments: &[String]) -> Result<(), Failure> {
    let Some(options) = parse(arguments)? else {
        print!("{USAGE}");
        return Ok(());
    };
    if let Some(port) = &options.flash {
        // Before the build, which takes minutes.
        check_port(port)?;
    }
    let car_id = options.car_id.unwrap_or(0);
    let programmer = options.flash.as_ref().map(|_| PROGRAMMER);
    let image = image::ensure(car_id, programmer.as_slice())?;
    let mut figures = cargo();
    figures
        .args(["run", "--package", "singletrack-sim"])
        .args(["--bin", "uno-figures"]);
    check_image(&image, car_id, &mut figures)?;
    options
        .flash
        .map_or(Ok(()), |port| flash(&image.elf, &port))
}

/// `None` for help.
pub(crate) fn parse(arguments: &[String]) -> Result<Option<Options>, Failure> {
    let refused = |reason: &str| failure!("{reason}\n\n{USAGE}");
    if let [help] = arguments
        && (help == "--help" || help == "-h")
    {
        return Ok(None);
    }
    let words: Vec<&str> = arguments
        .iter()
        .flat_map(|word| match word.split_once('=') {
            Some((name, value)) if name.starts_with("--") => vec![name, value],
            _ => vec![word.as_str()],
        })
        .collect();
    let mut options = Options::default();
    for option in words.chunks(2) {
        match option {
            ["--flash", port] if !port.is_empty() && options.flash.is_none() => {
                options.flash = Some(PathBuf::from(port));
            }
            ["--flash"] | ["--flash", ""] => {
                let reason = "--flash needs the UNO's port, such as /dev/ttyACM0";
                return Err(refused(reason));
            }
            ["--car-id", rest @ ..] if options.car_id.is_none() => {
                let value = rest.concat();
                let number = value.parse().ok().filter(|number| *number > 0);
                options.car_id = Some(number.ok_or_else(|| {
                    let wanted = "--car-id needs a number from 1 to 65535";
                    refused(&format!("{wanted}, not {value:?}"))
                })?);
            }
            _ => return Err(refused(&format!("unexpected argument {:?}", option[0]))),
        }
    }
    Ok(Some(options))
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
    // This image, not one named by the environment.
    let measured = text(measure.env("SINGLETRACK_UNO", &image.folder))?;
    let (table, wrong) = gates::judge(size, car_id, &measured)?;
    println!("\n{}\n\n{table}", image.elf.display());
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(Failure::Failed(wrong.join("; ")))
    }
}

/// Checks the port early, with clearer messages than avrdude's.
fn check_port(port: &Path) -> Result<(), Failure> {
    let name = port.display();
    let metadata = fs::metadata(port).map_err(|error| {
        failure!(
            "{name}: {error}. Is the UNO plugged in? `ls /dev/serial/by-id /dev/ttyACM* \
             /dev/ttyUSB*` lists the ports"
        )
    })?;
    if !metadata.file_type().is_char_device() {
        return Err(failure!("{name} is not a serial port"));
    }
    // Opening it would reset the board.
    let port = port.as_os_str();
    let may_use = Command::new("test")
        .args(["-r".as_ref(), port, "-a".as_ref(), "-w".as_ref(), port])
        .status();
    // Without this program, avrdude reports the error.
    if may_use.is_ok_and(|status| !status.success()) {
        return Err(failure!(
            "no permission for {name}: add yourself to the group that owns it, `sudo usermod \
             --append --groups dialout $USER`, and log in again"
        ));
    }
    Ok(())
}

/// Writes the image to the board's flash and verifies it.
fn flash(elf: &Path, port: &Path) -> Result<(), Failure> {
    let hex = elf.with_extension("hex");
    let mut convert = Command::new("avr-objcopy");
    convert.args(["-O", "ihex", "-R", ".eeprom"]);
    check(convert.args([elf, &hex]))?;
    let mut write = std::ffi::OsString::from("flash:w:");
    write.push(&hex);
    write.push(":i");
    let mut program = Command::new("avrdude");
    program.args("-p atmega328p -c arduino -b 115200 -D -P".split(' '));
    check(program.arg(port).arg("-U").arg(write)).map_err(|failure| {
        failure!(
            "{failure}. Does another program have {} open, the daemon perhaps? Is it an UNO with \
             its bootloader?",
            port.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Option<Options>, Failure> {
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
            assert_eq!(
                parsed(line).unwrap(),
                Some(Options { car_id, flash }),
                "{line}"
            );
        }
        assert_eq!(parse(&[]).unwrap(), Some(Options::default()));
        assert_eq!(parsed("--help").unwrap(), None);
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
