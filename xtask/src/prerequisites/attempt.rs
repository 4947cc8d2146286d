//! Tests of the prerequisites: each returns a description, or the reason of failure.

use std::path::{Path, PathBuf};

use crate::{
    compiler::{self, AVR, Target},
    foreign::Foreign,
    machine::{Answer, Machine, Scratch, answer},
};

/// Tests a component of the present toolchain.
pub(super) fn of_this_toolchain(machine: &Machine, command: &str) -> Result<String, String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    runs(machine, &cargo, [command, "--version"])
}

/// The first line of a program's output, if it succeeds.
pub(super) fn runs<const N: usize>(
    machine: &Machine,
    program: impl AsRef<std::ffi::OsStr>,
    arguments: [&str; N],
) -> Result<String, String> {
    let name = program.as_ref().to_string_lossy().into_owned();
    match machine.ask(&program, arguments) {
        None => Err(format!("no {name}")),
        Some(Answer { success, text, .. }) => {
            let line = text.lines().next().unwrap_or_default().to_owned();
            if success {
                Ok(line)
            } else {
                Err(format!("{name} fails: {line}"))
            }
        }
    }
}

/// Tests that clippy and rustc have the same minor release.
pub(super) fn clippy(machine: &Machine) -> Result<String, String> {
    let found = of_this_toolchain(machine, "clippy")?;
    let minor = |text: &str, prefix: &str| {
        let (_, rest) = text.split_once(prefix)?;
        let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
        Some(digits)
    };
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let rustc = runs(machine, &rustc, ["--version"])?;
    if minor(&found, "clippy 0.1.") == minor(&rustc, "rustc 1.") {
        Ok(found)
    } else {
        Err(format!("{found} does not match {rustc}"))
    }
}

pub(super) fn rust(machine: &Machine, target: Target) -> Result<String, String> {
    compiler::find(machine, target)
        .map(|found| found.to_string())
        .map_err(|reasons| reasons.join("\n"))
}

pub(super) fn image_clippy(machine: &Machine) -> Result<String, String> {
    let compiler =
        compiler::find(machine, AVR).map_err(|_| "no compiler for the Arduino".to_owned())?;
    let driver = compiler.clippy(machine)?;
    Ok(driver.display().to_string())
}

/// Links a C program with a compiler and returns it.
fn link(
    machine: &Machine,
    scratch: &Scratch,
    compiler: &str,
    source: &str,
    before: &[&str],
    after: &[&str],
) -> Result<PathBuf, String> {
    let mut words = compiler.split_whitespace();
    let name = words.next().unwrap_or_default();
    let file = scratch
        .file("probe.c", source)
        .map_err(|error| format!("can't write a test file: {error}"))?;
    let program = scratch.path().join("probe");
    let linked = answer(
        machine
            .command(name)
            .args(words)
            .args(before)
            .arg(file)
            .arg("-o")
            .arg(&program)
            .args(after),
    );
    match linked {
        None => Err(format!("no {name}")),
        Some(Answer { success: true, .. }) => Ok(program),
        Some(Answer { text, .. }) => Err(format!(
            "{name} does not link a program: {}",
            text.lines()
                .find(|line| line.contains("error") || line.contains("cannot"))
                .or_else(|| text.lines().next())
                .unwrap_or_default()
        )),
    }
}

/// A temporary folder for a probe.
fn scratch(name: &str) -> Result<Scratch, String> {
    Scratch::new(name).map_err(|error| format!("can't create a folder for a probe: {error}"))
}

/// cc, or the compiler in `CC`, possibly with a wrapper.
fn cc() -> String {
    std::env::var("CC").unwrap_or_else(|_| "cc".to_owned())
}

pub(super) fn c_compiler(machine: &Machine) -> Result<String, String> {
    let cc = cc();
    link(
        machine,
        &scratch("cc")?,
        &cc,
        "#include <stdio.h>\nint main(void) { return puts(\"\") < 0; }\n",
        &[],
        &[],
    )?;
    Ok(format!("{cc} links a program"))
}

pub(super) fn image_linker(machine: &Machine) -> Result<String, String> {
    link(
        machine,
        &scratch("avr")?,
        "avr-gcc",
        "#include <avr/io.h>\nint main(void) { return PORTB; }\n",
        &["-mmcu=atmega328p"],
        &[],
    )?;
    for tool in ["avr-nm", "avr-size", "avr-objcopy"] {
        runs(machine, tool, ["--version"])?;
    }
    runs(machine, "avr-gcc", ["--version"])
}

pub(super) fn simavr(machine: &Machine) -> Result<String, String> {
    let scratch = scratch("simavr")?;
    let program = link(
        machine,
        &scratch,
        &cc(),
        "#include <sim_avr.h>\n\
         int main(void) { return avr_make_mcu_by_name(\"atmega328p\") ? 0 : 1; }\n",
        &["-I/usr/include/simavr"],
        // The static library, as in the simulator.
        &["-l:libsimavr.a", "-lelf"],
    )?;
    runs(machine, &program, [])
        .map_err(|why| format!("a program that creates an ATmega328P: {why}"))?;
    Ok("creates an ATmega328P".to_owned())
}

/// Exit code of the program for the emulator.
const ANSWER: i32 = 42;

fn link_for(foreign: &Foreign, machine: &Machine, scratch: &Scratch) -> Result<PathBuf, String> {
    link(
        machine,
        scratch,
        &foreign.c_compiler(),
        &format!("#include <stdlib.h>\nint main(void) {{ exit({ANSWER}); }}\n"),
        &[],
        &[],
    )
}

pub(super) fn linker(foreign: &Foreign, machine: &Machine) -> Result<String, String> {
    link_for(foreign, machine, &scratch("arm")?)?;
    runs(machine, foreign.c_compiler(), ["--version"])
}

pub(super) fn emulator(foreign: &Foreign, machine: &Machine) -> Result<String, String> {
    let scratch = scratch("qemu")?;
    let program =
        link_for(foreign, machine, &scratch).map_err(|why| format!("no program to run: {why}"))?;
    let qemu = foreign.qemu;
    let status = machine
        .command(qemu)
        .args(foreign.qemu_options())
        .arg(program)
        .status()
        .map_err(|_| format!("no {qemu}"))?;
    if status.code() != Some(ANSWER) {
        return Err(format!("{qemu} does not run a program: {status}"));
    }
    runs(machine, qemu, ["--version"])
}

/// debhelper, with the addition that makes users and groups, and what it calls.
pub(super) fn debhelper(machine: &Machine) -> Result<String, String> {
    const ADDITION: &str = "installsysusers";
    for tool in ["dpkg-architecture", "dpkg-deb", "man"] {
        runs(machine, tool, ["--version"])?;
    }
    match machine.ask("dh", ["--list"]) {
        None => Err("no dh".to_owned()),
        Some(found) if found.text.lines().any(|line| line == ADDITION) => {
            Ok(format!("dh with {ADDITION}"))
        }
        Some(_) => Err(format!("dh lacks {ADDITION}: debhelper is too old")),
    }
}

pub(super) fn systemd(machine: &Machine) -> Result<String, String> {
    const OLDEST: u32 = 250;
    let first_line = runs(machine, "systemd-analyze", ["--version"])?;
    let version: Option<u32> = first_line.split_whitespace().nth(1).and_then(|word| {
        let digits: String = word.chars().take_while(char::is_ascii_digit).collect();
        digits.parse().ok()
    });
    if version.is_none_or(|version| version < OLDEST) {
        return Err(format!("{first_line}, not {OLDEST} or later"));
    }
    // The unit uses it to reload the daemon.
    if !Path::new("/bin/kill").exists() {
        return Err("no /bin/kill, which the unit uses".to_owned());
    }
    Ok(first_line)
}

/// A Python that can create environments: the one in the path, or else Debian's,
/// which has that in a separate package.
pub(crate) fn python(machine: &Machine) -> Result<PathBuf, String> {
    const NEEDED: &str = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))";
    let mut found = Vec::new();
    for python in ["python3", "/usr/bin/python3"] {
        match machine.ask(python, ["-c", NEEDED]) {
            Some(Answer { success: true, .. }) => return Ok(python.into()),
            Some(_) => {
                let version = runs(machine, python, ["--version"]).unwrap_or_default();
                found.push(format!(
                    "{python} ({version}) lacks venv or ensurepip, or is older"
                ));
            }
            None => found.push(format!("no {python}")),
        }
    }
    Err(found.join("; "))
}

/// Octave that connects by TCP and reads JSON.
pub(super) fn octave(machine: &Machine) -> Result<String, String> {
    const NEEDED: &str = "pkg load instrument-control; jsondecode('1'); \
                          assert(exist('tcpclient') > 0); disp(OCTAVE_VERSION)";
    let options = [
        "--quiet",
        "--no-history",
        "--no-init-file",
        "--eval",
        NEEDED,
    ];
    runs(machine, "octave-cli", options)
}

/// What builds messages for rclpy and runs it apart from every network.
pub(super) fn ros(machine: &Machine) -> Result<String, String> {
    const NEEDED: &str = "import os, sys, sysconfig; \
                          header = sysconfig.get_paths()['include'] + '/Python.h'; \
                          sys.exit(sys.version_info >= (3, 14) or not os.path.exists(header))";
    let python = python(machine)?;
    let name = python.to_string_lossy().into_owned();
    match machine.ask(&name, ["-c", NEEDED]) {
        Some(Answer { success: true, .. }) => {}
        _ => return Err(format!("{name} lacks its headers, or is 3.14 or later")),
    }
    runs(machine, "c++", ["--version"])?;
    let [user, network] = crate::ros::NAMESPACE;
    runs(machine, "unshare", [user, network, "ip", "link"])?;
    runs(machine, &name, ["--version"])
}

pub(super) fn slurm(machine: &Machine) -> Result<String, String> {
    // The path of a user may lack the folder of the daemons.
    const DAEMONS: &str = "PATH=$PATH:/usr/sbin; munged --version && slurmctld -V && slurmd -V";
    runs(machine, "sh", ["-c", DAEMONS])?;
    let [user, network] = crate::ros::NAMESPACE;
    runs(machine, "unshare", [user, network, "ip", "link"])?;
    // Without a cluster it does not even tell its version.
    runs(machine, "sh", ["-c", "command -v sbatch"])
}
