//! Compilers for the Arduino and the Odroid: they need nightly features and the
//! sources of the standard library. Candidates are searched and tested.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use crate::machine::{COMPILER_VARIABLE, Machine, Scratch, answer};

/// Target of a compiler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Target {
    pub(crate) triple: &'static str,
    /// Name in messages.
    pub(crate) name: &'static str,
    /// Compiler options of this target.
    flags: &'static [&'static str],
    /// Crates that are built from source for it.
    libraries: &'static [&'static str],
}

/// The Arduino's processor.
pub(crate) const AVR: Target = Target {
    triple: "avr-none",
    name: "Rust for the Arduino",
    flags: &["-Ctarget-cpu=atmega328p"],
    libraries: &["core"],
};

/// The Odroid's processor, Debian's armhf.
pub(crate) const ARM: Target = Target {
    triple: "armv7-unknown-linux-gnueabihf",
    name: "Rust for the Odroid",
    flags: &[],
    libraries: &["core", "std"],
};

/// The 64-bit processors of Raspberry Pi and its like, Debian's arm64.
pub(crate) const ARM64: Target = Target {
    triple: "aarch64-unknown-linux-gnu",
    name: "Rust for ARM64",
    flags: &[],
    libraries: &["core", "std"],
};

/// Oldest release that builds the workspace: its `rust-version`.
const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// A compiler that has been tested for a target.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Compiler {
    pub(crate) rustc: PathBuf,
    /// Cargo of the same toolchain, if any: it matches the layout of that
    /// toolchain's standard library.
    pub(crate) cargo: Option<PathBuf>,
    /// Release, for example `1.96.0`.
    release: String,
    origin: Origin,
}

/// Origin of a compiler.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Origin {
    Variable,
    /// A toolchain of rustup, by name.
    Rustup(String),
    Debian,
}

impl fmt::Display for Origin {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Variable => write!(formatter, "named by {COMPILER_VARIABLE}"),
            Self::Rustup(toolchain) => write!(formatter, "rustup's {toolchain}"),
            Self::Debian => formatter.write_str("Debian's rustc-web"),
        }
    }
}

impl fmt::Display for Compiler {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "rustc {} ({}, {})",
            self.release,
            self.origin,
            self.rustc.display()
        )
    }
}

impl Compiler {
    /// Clippy of this compiler, or the reason why there is none.
    pub(crate) fn clippy(&self, machine: &Machine) -> Result<PathBuf, String> {
        let driver = self.rustc.with_file_name("clippy-driver");
        let fix = match &self.origin {
            Origin::Rustup(toolchain) => {
                format!(": rustup component add clippy --toolchain {toolchain}")
            }
            _ => String::new(),
        };
        let Some(answer) = machine.ask(&driver, ["--rustc", "-vV"]) else {
            return Err(format!("{} does not start{fix}", driver.display()));
        };
        match release(&answer.stdout) {
            Some(of) if of == self.release => Ok(driver),
            Some(of) => Err(format!(
                "{} is of rustc {of}, the compiler is {}{fix}",
                driver.display(),
                self.release
            )),
            None => Err(format!("{} does not run{fix}", driver.display())),
        }
    }

    /// Whether Debian's packages update it.
    pub(crate) fn is_debians(&self) -> bool {
        self.origin == Origin::Debian
    }
}

/// Finds the first compiler that can build for a target: the one named by the
/// environment, a nightly of rustup with `rust-src`, Debian's. Otherwise returns
/// one reason per candidate.
pub(crate) fn find(machine: &Machine, target: Target) -> Result<Compiler, Vec<String>> {
    if let Some(rustc) = &machine.named_compiler {
        // A named compiler is not replaced by another.
        return attempt(machine, target, rustc, Origin::Variable).map_err(|why| vec![why]);
    }
    let mut reasons = Vec::new();
    for toolchain in nightlies(machine) {
        let found = machine.ask("rustup", ["which", "--toolchain", &toolchain, "rustc"]);
        let Some(rustc) = found.filter(|found| found.success) else {
            reasons.push(format!("rustup's {toolchain} has no rustc"));
            continue;
        };
        let rustc = PathBuf::from(rustc.stdout);
        match attempt(machine, target, &rustc, Origin::Rustup(toolchain)) {
            Ok(compiler) => return Ok(compiler),
            Err(why) => reasons.push(why),
        }
    }
    attempt(machine, target, &machine.debian_compiler, Origin::Debian).map_err(|why| {
        reasons.push(why);
        reasons
    })
}

/// The names of rustup's nightly toolchains.
fn nightlies(machine: &Machine) -> Vec<String> {
    machine
        .ask("rustup", ["toolchain", "list"])
        .filter(|list| list.success)
        .map(|list| {
            list.stdout
                .lines()
                .filter_map(|line| line.split_whitespace().next())
                .filter(|name| name.starts_with("nightly"))
                .map(str::to_owned)
                .collect()
        })
        .unwrap_or_default()
}

/// Tests a compiler; the error says what it lacks.
fn attempt(
    machine: &Machine,
    target: Target,
    rustc: &Path,
    origin: Origin,
) -> Result<Compiler, String> {
    let place = rustc.display();
    let Some(version) = machine.ask(rustc, ["-vV"]) else {
        return Err(match origin {
            Origin::Debian => format!("no {place}: Debian's rustc-web is not installed"),
            _ => format!("{place} ({origin}) does not start"),
        });
    };
    let Some(release) = release(&version.stdout).map(str::to_owned) else {
        return Err(format!("{place} ({origin}) does not print its release"));
    };
    let lacks = |what: String| Err(format!("{place}, rustc {release} ({origin}), {what}"));
    if !at_least(&release, OLDEST) {
        return lacks(format!("is older than {OLDEST}"));
    }
    if let Err(why) = compile(machine, target, rustc) {
        return lacks(format!("can't compile for {}{why}", target.triple));
    }
    let sources = sources(machine, rustc);
    let missing = target.libraries.iter().find(|library| {
        sources
            .as_ref()
            .is_none_or(|folder| !folder.join(library).join("src/lib.rs").is_file())
    });
    if let Some(library) = missing {
        let fix = match &origin {
            Origin::Rustup(toolchain) => {
                format!(": rustup component add rust-src --toolchain {toolchain}")
            }
            _ => String::new(),
        };
        return lacks(format!("has no sources of {library}{fix}"));
    }
    let cargo = rustc.with_file_name("cargo");
    let cargo = machine
        .ask(&cargo, ["-vV"])
        .is_some_and(|answer| {
            self::release(&answer.stdout).is_some_and(|of| minor(of) == minor(&release))
        })
        .then_some(cargo);
    Ok(Compiler {
        rustc: rustc.to_path_buf(),
        cargo,
        release,
        origin,
    })
}

/// The value of `release:` in the output of `rustc -vV`.
fn release(version: &str) -> Option<&str> {
    version
        .lines()
        .find_map(|line| line.strip_prefix("release: "))
        .map(str::trim)
}

/// Major and minor of a release such as `1.97.0-nightly`.
fn minor(release: &str) -> Option<(u32, u32)> {
    let mut parts = release.split('.');
    Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
}

fn at_least(release: &str, oldest: &str) -> bool {
    minor(release).is_some_and(|release| Some(release) >= minor(oldest))
}

/// Compiles a crate without libraries to an object file for the target: a compiler
/// may know the target but lack the back end. The error is the compiler's first
/// one.
fn compile(machine: &Machine, target: Target, rustc: &Path) -> Result<(), String> {
    let failed = |error: std::io::Error| format!(": can't create a test file: {error}");
    let scratch = Scratch::new("compiler").map_err(failed)?;
    let source = "#![feature(no_core)]\n#![allow(internal_features)]\n#![no_core]\n";
    let file = scratch.file("nothing.rs", source).map_err(failed)?;
    let mut object = std::ffi::OsString::from("--emit=obj=");
    object.push(scratch.path().join("nothing.o"));
    let compiled = answer(
        machine
            .command(rustc)
            .env("RUSTC_BOOTSTRAP", "1")
            .args(["--crate-type=lib", "--target", target.triple])
            .args(target.flags)
            .arg(object)
            .arg(file),
    );
    match compiled {
        Some(compiled) if compiled.success => Ok(()),
        Some(compiled) => {
            let error = compiled.text.lines().find(|line| line.starts_with("error"));
            Err(error.map_or_else(String::new, |error| format!(": {error}")))
        }
        None => Err(": it does not start".to_owned()),
    }
}

/// Folder of the sources of the standard library, if present.
fn sources(machine: &Machine, rustc: &Path) -> Option<PathBuf> {
    let sysroot = machine
        .ask(rustc, ["--print", "sysroot"])
        .filter(|sysroot| sysroot.success)?;
    Some(Path::new(&sysroot.stdout).join("lib/rustlib/src/rust/library"))
}

/// Stand-ins for compilers.
#[cfg(test)]
pub(crate) mod stand_in {
    use super::*;
    use crate::machine::stand_in::Bare;

    /// A script that imitates rustc.
    pub(crate) fn rustc(machine: &Bare, release: &str, target: &str, sysroot: &str) -> String {
        let sysroot = machine.folder.join(sysroot);
        format!(
            "case \"$*\" in\n\
             *--target*{target}*) exit 0 ;;\n\
             *--target*) exit 1 ;;\n\
             '-vV') echo 'release: {release}' ;;\n\
             '--print sysroot') echo '{}' ;;\n\
             esac",
            sysroot.display()
        )
    }

    pub(crate) fn add_sources(machine: &Bare, sysroot: &str, libraries: &[&str]) {
        for library in libraries {
            let place = format!("{sysroot}/lib/rustlib/src/rust/library/{library}/src/lib.rs");
            machine.write(Path::new(&place), "");
        }
    }

    /// Debian's compiler of a release, with sources and clippy.
    pub(crate) fn add_debians(machine: &Bare, release: &str, target: &str) {
        let script = rustc(machine, release, target, "debian");
        machine.write(Path::new("debian/bin/rustc"), &script);
        add_sources(machine, "debian", &["core", "std"]);
        let clippy = format!("echo 'release: {release}'");
        machine.write(Path::new("debian/bin/clippy-driver"), &clippy);
    }

    /// A rustup with one nightly.
    pub(crate) fn add_nightly(machine: &Bare, release: &str, libraries: &[&str]) -> PathBuf {
        let script = rustc(machine, release, "avr-none", "nightly");
        let path = machine.write(Path::new("nightly/bin/rustc"), &script);
        add_sources(machine, "nightly", libraries);
        machine.program(
            "rustup",
            &format!(
                "case \"$*\" in\n\
                 'toolchain list') echo 'stable-x86_64 (active, default)'; echo nightly-x86_64 ;;\n\
                 'which --toolchain nightly-x86_64 rustc') echo '{}' ;;\n\
                 *) exit 1 ;;\n\
                 esac",
                path.display()
            ),
        );
        path
    }
}

#[cfg(test)]
mod tests {
    use super::{
        stand_in::{add_debians, add_nightly, add_sources, rustc},
        *,
    };
    use crate::machine::stand_in::Bare;

    #[test]
    fn a_compiler_that_the_environment_names_comes_first() {
        let mut machine = Bare::new("named");
        add_debians(&machine, "1.96.0", "avr-none");
        add_nightly(&machine, "1.99.0-nightly", &["core"]);
        let script = rustc(&machine, "1.97.0", "avr-none", "mine");
        let mine = machine.write(Path::new("mine/bin/rustc"), &script);
        add_sources(&machine, "mine", &["core"]);
        machine.machine.named_compiler = Some(mine.clone());
        let found = find(&machine.machine, AVR).unwrap();
        assert_eq!(found.rustc, mine);
        assert_eq!(
            found.to_string(),
            format!(
                "rustc 1.97.0 (named by SINGLETRACK_RUSTC, {})",
                mine.display()
            )
        );
    }

    #[test]
    fn an_unsuitable_named_compiler_is_not_replaced() {
        let mut machine = Bare::new("named-short");
        add_debians(&machine, "1.96.0", "avr-none");
        let script = rustc(&machine, "1.97.0", "none-of-ours", "mine");
        machine.machine.named_compiler = Some(machine.write(Path::new("mine/bin/rustc"), &script));
        let reasons = find(&machine.machine, AVR).unwrap_err();
        assert_eq!(reasons.len(), 1);
        assert!(
            reasons[0].contains("SINGLETRACK_RUSTC")
                && reasons[0].ends_with("can't compile for avr-none"),
            "{reasons:?}"
        );
        machine.machine.named_compiler = Some("/no/such/rustc".into());
        let reasons = find(&machine.machine, AVR).unwrap_err();
        assert!(reasons[0].contains("does not start"), "{reasons:?}");
    }

    #[test]
    fn a_nightly_with_sources_comes_before_debians() {
        let machine = Bare::new("nightly");
        add_debians(&machine, "1.96.0", "avr-none");
        let nightly = add_nightly(&machine, "1.99.0-nightly", &["core"]);
        let found = find(&machine.machine, AVR).unwrap();
        assert_eq!(found.rustc, nightly);
        assert!(
            found.to_string().contains("rustup's nightly-x86_64"),
            "{found}"
        );
        assert_eq!(found.cargo, None);
    }

    #[test]
    fn the_cargo_next_to_a_compiler_is_used_if_of_the_same_release() {
        let machine = Bare::new("cargo");
        add_nightly(&machine, "1.99.0-nightly", &["core"]);
        let cargo = machine.write(Path::new("nightly/bin/cargo"), "echo 'release: 1.99.0'");
        assert_eq!(find(&machine.machine, AVR).unwrap().cargo, Some(cargo));
        machine.write(Path::new("nightly/bin/cargo"), "echo 'release: 0.66.0'");
        assert_eq!(find(&machine.machine, AVR).unwrap().cargo, None);
    }

    #[test]
    fn a_nightly_without_sources_is_skipped() {
        let machine = Bare::new("without-sources");
        add_debians(&machine, "1.96.0", "avr-none");
        add_nightly(&machine, "1.99.0-nightly", &[]);
        let found = find(&machine.machine, AVR).unwrap();
        assert!(found.is_debians());
    }

    #[test]
    fn without_a_suitable_compiler_each_reason_has_a_fix() {
        let machine = Bare::new("none");
        add_nightly(&machine, "1.99.0-nightly", &[]);
        let reasons = find(&machine.machine, AVR).unwrap_err();
        assert_eq!(reasons.len(), 2, "{reasons:?}");
        assert!(
            reasons[0].ends_with(
                "has no sources of core: rustup component add rust-src --toolchain nightly-x86_64"
            ),
            "{reasons:?}"
        );
        assert!(
            reasons[1].ends_with("Debian's rustc-web is not installed"),
            "{reasons:?}"
        );
    }

    #[test]
    fn compilers_are_tested_for_release_and_target() {
        for (test, release, target, tested, lack) in [
            ("old", "1.85.0", "avr-none", AVR, "is older than 1.95"),
            (
                "no-avr",
                "1.96.0",
                "armv7",
                AVR,
                "can't compile for avr-none",
            ),
            (
                "no-arm",
                "1.96.0",
                "avr-none",
                ARM,
                "can't compile for armv7",
            ),
        ] {
            let machine = Bare::new(test);
            add_debians(&machine, release, target);
            let reasons = find(&machine.machine, tested).unwrap_err();
            assert!(reasons[0].contains(lack), "{reasons:?}");
        }
    }

    #[test]
    fn the_odroid_needs_the_sources_of_the_complete_standard_library() {
        let machine = Bare::new("std");
        let script = rustc(&machine, "1.96.0", "armv7", "debian");
        machine.write(Path::new("debian/bin/rustc"), &script);
        add_sources(&machine, "debian", &["core"]);
        let reasons = find(&machine.machine, ARM).unwrap_err();
        assert!(reasons[0].ends_with("has no sources of std"), "{reasons:?}");
        add_sources(&machine, "debian", &["std"]);
        find(&machine.machine, ARM).unwrap();
    }

    #[test]
    fn clippy_must_be_of_the_same_release() {
        let machine = Bare::new("clippy");
        add_debians(&machine, "1.96.0", "avr-none");
        let compiler = find(&machine.machine, AVR).unwrap();
        compiler.clippy(&machine.machine).unwrap();
        machine.write(
            Path::new("debian/bin/clippy-driver"),
            "echo 'release: 1.85.0'",
        );
        let why = compiler.clippy(&machine.machine).unwrap_err();
        assert!(
            why.ends_with("is of rustc 1.85.0, the compiler is 1.96.0"),
            "{why}"
        );
    }

    #[test]
    fn releases_are_compared_as_numbers() {
        assert!(at_least("1.100.0", "1.95"));
        assert!(at_least("1.95.0", "1.95"));
        assert!(at_least("2.0.0-nightly", "1.95"));
        assert!(!at_least("1.94.9", "1.95"));
        assert!(!at_least("", "1.95"));
    }
}
