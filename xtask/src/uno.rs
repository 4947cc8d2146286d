//! `cargo uno`: builds, checks and flashes the Arduino's image. It and the program that runs it are
//! placed where the simulator searches them: in `uno` in the target folder.

use std::{
    io::{self, IsTerminal},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    options,
    prerequisites::{self, AVR, AVR_CLIPPY, Compiler},
    process::{Result, check, command, failure, require, silent, text},
    workspace::{cargo, lint_and_document, put, root, target},
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
    let Options { car_id, flash } = parse(arguments)?;
    // Before the build, which takes minutes.
    flash.as_deref().map(check_port).transpose()?;
    let car_id = car_id.unwrap_or(0);
    let programmer = flash.as_ref().map(|_| "flash");
    let image = ensure(car_id, programmer.as_slice())?;
    let mut figures = cargo("run --package singletrack-sim --bin uno-figures");
    check_image(&image, car_id, &mut figures)?;
    flash.map_or(Ok(()), |port| write_image(&image.join(IMAGE), &port))
}

pub(crate) fn parse(arguments: &[String]) -> Result<Options> {
    let mut found = Options::default();
    for option in options(arguments, &["--flash", "--car-id"]) {
        match option {
            ("--flash", None | Some("")) => {
                let port = "--flash needs the UNO's port, such as /dev/ttyACM0";
                return Err(failure!("{port}\n\n{USAGE}"));
            }
            ("--flash", Some(port)) if found.flash.is_none() => found.flash = Some(port.into()),
            ("--car-id", value) if found.car_id.is_none() => {
                let value = value.unwrap_or_default();
                found.car_id = value.parse().ok().filter(|number| *number > 0);
                let is_valid = found.car_id.is_some();
                let wanted = "--car-id needs a number from 1 to 65535";
                require!(is_valid, "{wanted}, not {value:?}\n\n{USAGE}");
            }
            (option, _) => return Err(failure!("unexpected argument {option:?}\n\n{USAGE}")),
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
    let target = target()?;
    let mut build = image_build(&Compiler::find(AVR)?, &target);
    build.args(quiet()).env(CAR_ID, car_id.to_string());
    check(build.stdout(Stdio::null()))?;
    build_simulator()?;
    let folder = target.join("uno");
    let built = target.join("uno-build/avr-none/release");
    put(&built.join(IMAGE), &folder.join(IMAGE))?;
    put(&built.join(CYCLES), &folder.join(CYCLES))?;
    let simulator = target.join("debug/singletrack-simavr");
    put(&simulator, &folder.join("singletrack-simavr"))?;
    Ok(folder)
}

/// Checks that the image builds without warnings of compiler, clippy and rustdoc.
pub(crate) fn lint() -> Result {
    let compiler = Compiler::find(AVR_CLIPPY)?;
    let mut build = image_build(&compiler, &target()?);
    lint_and_document(&mut build, &compiler.rustc.with_file_name("clippy-driver"))?;
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
    // Suppresses the warning that AVR's linker does not support -no-pie.
    cargo.env("RUSTC_LOG", "error").env(CAR_ID, "0");
    cargo.args(["build", "--release", "--locked", "--target-dir"]);
    cargo.arg(target.join("uno-build"));
    cargo
}

/// Checks the image for a car, in its folder, against its budgets, with the measuring program: forbidden
/// symbols, and use of flash, SRAM and processor.
pub(crate) fn check_image(folder: &Path, car_id: u16, measure: &mut Command) -> Result {
    for image in [IMAGE, CYCLES] {
        let elf = folder.join(image);
        let symbols = text(command("avr-nm").arg(&elf))?;
        forbidden(&symbols).map_err(|why| failure!("{}: {why}", elf.display()))?;
    }
    let elf = folder.join(IMAGE);
    let size = size_of(&text(command("avr-size").arg(&elf))?)
        .ok_or_else(|| failure!("{}: avr-size finds no program", elf.display()))?;
    // This image, not one named by the environment.
    let measured = text(measure.env("SINGLETRACK_UNO", folder))?;
    let (table, wrong) = judge(size, car_id, &measured)?;
    println!("\n{}\n\n{table}", elf.display());
    require!(wrong.is_empty(), "{}", wrong.join("; "));
    Ok(())
}

/// The processor has 32,768 B of flash, and 2,048 B of SRAM for variables and stack.
const BUDGETS: [(&str, f64, &str); 3] = [
    ("flash", 24_576.0, "B"),
    ("SRAM in all", 1_400.0, "B"),
    ("cpu", 20.0, "%"),
];

/// Refuses symbols that are known to fail on an AVR.
fn forbidden(symbols: &str) -> Result<(), String> {
    let lines = symbols.lines();
    let names: Vec<&str> = lines
        .filter_map(|line| line.split_whitespace().last())
        .collect();
    if !names.iter().any(|name| name.starts_with("__vector_")) {
        return Err("no interrupt among its symbols, so it can't be checked".into());
    }
    for name in names {
        if ["__mulosi4", "__mulodi4", "__muloti4"].contains(&name) {
            return Err(format!(
                "it contains {name}, which is miscompiled on AVR: the caller has 2 bytes on its stack \
                 for the overflow, the function writes 4. The image must not use checked_mul, \
                 overflowing_mul or saturating_mul of i32 and wider, nor overflow checks: bound the \
                 factors, or multiply in a wider type"
            ));
        }
        // The mangled path of core::fmt, and of its traits in implementations.
        if name.contains("4core3fmt") || name.contains("core..fmt..") {
            return Err(format!(
                "it contains {name}: formatting takes 3 to 7 KB of flash, and the text is never shown. \
                 Look for a derived Debug, unwrap, expect or an index that can panic"
            ));
        }
    }
    Ok(())
}

/// Flash and static SRAM of the image by avr-size, in bytes.
fn size_of(text: &str) -> Option<[f64; 2]> {
    let numbers = text.lines().nth(1)?.split_whitespace();
    let numbers: Vec<f64> = numbers.map_while(|word| word.parse().ok()).collect();
    let [code, data, zeroed, ..] = numbers[..] else {
        return None;
    };
    // Initial values and constants are in flash and in SRAM.
    (code > 0.0).then_some([code + data, data + zeroed])
}

/// Name, value and unit of what was measured.
type Figure<'a> = (&'a str, f64, &'a str);

/// Compares what `uno-figures` has measured, in lines such as `stack 248 B`, with the budgets, with
/// the size by avr-size and with the car that the image is for. Returns a table, and what is wrong.
fn judge(
    [flash, static_sram]: [f64; 2],
    car_id: u16,
    measured: &str,
) -> Result<(String, Vec<String>)> {
    let lines = measured.lines().filter(|line| !line.trim().is_empty());
    let mut figures = lines.map(figure).collect::<Result<Vec<_>>>()?;
    let find = |figures: &[Figure<'_>], name, unit| {
        let figure = figures.iter().find(|one| (one.0, one.2) == (name, unit));
        let value = figure.map(|figure| figure.1);
        value.ok_or_else(|| failure!("uno-figures prints no `{name}` in {unit}"))
    };
    let sram = find(&figures, "static", "B")? + find(&figures, "stack", "B")?;
    figures.insert(0, ("SRAM in all", sram, "B"));
    let mut wrong = Vec::new();
    let mut expect = |holds: bool, why: String| wrong.extend((!holds).then_some(why));
    // uno-figures reads the file independently of avr-size.
    for (name, ours) in [("flash", flash), ("static", static_sram)] {
        let theirs = find(&figures, name, "B")?;
        let numbers = format!("{name}: {ours} B by avr-size, {theirs} B by uno-figures");
        let why = format!("{numbers}: one of them reads the image wrongly");
        expect(theirs == ours, why);
    }
    for (name, budget, unit) in BUDGETS {
        let value = find(&figures, name, unit)?;
        let why = format!("{name}: {value} {unit} are more than the budget of {budget} {unit}");
        expect(value <= budget, why);
    }
    let greeted = find(&figures, "car-id", "greeted")?;
    let why = format!("the image is for car {car_id}, and greets as car {greeted}");
    expect(greeted == f64::from(car_id), why);
    let table = figures.iter().map(|(name, value, unit)| {
        let budget = BUDGETS.iter().find(|budget| budget.0 == *name);
        let budget = budget.map_or(String::new(), |(_, most, _)| format!("  of {most}"));
        format!("{name:30} {value:>9} {unit}{budget}\n")
    });
    Ok((table.collect(), wrong))
}

/// A figure in a line, in which only the name may contain blanks.
fn figure(line: &str) -> Result<Figure<'_>> {
    let parts = || {
        let (rest, unit) = line.trim().rsplit_once(' ')?;
        let (name, value) = rest.trim_end().rsplit_once(' ')?;
        let value = value.parse().ok().filter(|value: &f64| value.is_finite())?;
        Some((name.trim_end(), value, unit))
    };
    parts().ok_or_else(|| failure!("uno-figures: {line:?} is not of the form `name value unit`"))
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
fn write_image(elf: &Path, port: &Path) -> Result {
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

    #[test]
    fn initial_values_count_in_flash_and_in_sram() {
        let text = "   text\t   data\t    bss\t    dec\t    hex\tfilename\n   \
                    6450\t     62\t    227\t   6739\t   1a53\tuno.elf\n";
        assert_eq!(size_of(text), Some([6_512.0, 289.0]));
        assert_eq!(size_of("text data bss\n0 0 0 0 0 empty.elf\n"), None);
        assert_eq!(size_of(""), None);
    }

    #[test]
    fn forbidden_symbols_are_reported() {
        let image = |name: &str| forbidden(&format!("00000080 T __vector_1\n00000a12 T {name}\n"));
        assert_eq!(image("_ZN15singletrack_uno4main17h0E"), Ok(()));
        for name in [
            "__mulosi4",
            "__mulodi4",
            "__muloti4",
            // Formatting, with either mangling.
            "_ZN4core3fmt9Formatter3pad17h0123456789abcdefE",
            "_RNvNtCs1234_4core3fmt5write",
            "_ZN42_$LT$u8$u20$as$u20$core..fmt..Debug$GT$3fmt17h01E",
        ] {
            assert!(image(name).unwrap_err().contains(name), "{name}");
        }
        assert!(forbidden("").is_err(), "a stripped image");
    }

    fn wrong(lines: &str) -> String {
        let judged = judge(
            [6_512.0, 289.0],
            7,
            &format!("{lines}interrupt INT0, most 56 cycles\n"),
        );
        match judged {
            Ok((_, wrong)) => wrong.join("; "),
            Err(failure) => failure.to_string(),
        }
    }

    #[test]
    fn every_exceeded_budget_is_reported() {
        let measured = |stack: u32, cpu: f64| {
            format!("flash 6512 B\nstatic 289 B\nstack {stack} B\ncpu {cpu} %\ncar-id 7 greeted\n")
        };
        assert_eq!(wrong(&measured(1_111, 20.0)), "");
        assert_eq!(
            wrong(&measured(1_112, 20.25)),
            "SRAM in all: 1401 B are more than the budget of 1400 B; \
             cpu: 20.25 % are more than the budget of 20 %"
        );
        let (table, _) = judge([6_512.0, 289.0], 7, &measured(248, 7.12)).unwrap();
        assert!(
            table.contains("SRAM in all                          537 B  of 1400\n"),
            "{table}"
        );
    }

    #[test]
    fn contradictions_and_missing_figures_are_refused() {
        for (lines, why) in [
            (
                "flash 6513 B\nstatic 289 B\nstack 2 B\ncpu 7 %\ncar-id 7 greeted\n",
                "reads the image wrongly",
            ),
            (
                "flash 6512 B\nstatic 288 B\nstack 2 B\ncpu 7 %\ncar-id 7 greeted\n",
                "reads the image wrongly",
            ),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 B\ncpu 7 %\ncar-id 0 greeted\n",
                "greets as car 0",
            ),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 B\ncpu 7 %\n",
                "no `car-id`",
            ),
            ("flash 6512 B\nstatic 289 B\nstack 2 B\n", "no `cpu` in %"),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 %\ncpu 7 %\n",
                "no `stack` in B",
            ),
            ("stack\n", "not of the form"),
            ("248 B\n", "not of the form"),
            ("stack many B\n", "not of the form"),
            ("stack NaN B\n", "not of the form"),
        ] {
            assert!(wrong(lines).contains(why), "{lines}{}", wrong(lines));
        }
    }
}
