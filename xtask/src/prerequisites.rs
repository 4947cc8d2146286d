//! Prerequisites of the checks. Each has a probe, a shell script that uses it: an installed package
//! may be too old, and a program may have been installed without a package.

use std::{env, fmt::Write as _, path::PathBuf};

use singletrack_words::words;

use crate::{
    process::Failure,
    shell::{answer, shell},
    toolchain::{AARCH64, ARMHF, AVR},
};

words! {
    /// An optional part of the checks, with its prerequisites.
    pub(crate) enum Part {
        /// The Arduino's image, and the simulated Arduino that runs it.
        Uno = "uno",
        /// The build for the Odroid, emulated.
        Odroid = "odroid",
        /// The Python readers of records.
        Readers = "readers",
        /// The Python package.
        Python = "python",
        /// ROS 2 in Python.
        Ros = "ros",
        /// Cars on other computers by way of a zenoh router.
        Zenoh = "zenoh",
        /// Octave, for MATLAB's language.
        Octave = "octave",
        /// The page in a browser.
        Browser = "browser",
        /// Campaigns on a cluster.
        Slurm = "slurm",
        /// systemd's verification of the service.
        Units = "units",
        /// The Debian package.
        Debian = "debian",
    }
}

use Part::{Browser, Debian, Octave, Odroid, Python, Readers, Ros, Slurm, Units, Uno};

/// A capability that a machine must have.
#[derive(Clone, Copy)]
pub(crate) struct Prerequisite {
    /// The parts that need it; none if every check does.
    parts: &'static [Part],
    name: &'static str,
    /// Its packages in Debian 12.
    packages: &'static str,
    /// A script with the functions of `prerequisites.sh`. It prints what was found, or fails.
    probe: &'static str,
    /// How to get it without the packages.
    hint: &'static str,
}

const fn row(
    parts: &'static [Part],
    name: &'static str,
    packages: &'static str,
    probe: &'static str,
) -> Prerequisite {
    let hint = "";
    Prerequisite {
        parts,
        name,
        packages,
        probe,
        hint,
    }
}

impl Prerequisite {
    const fn or(self, hint: &'static str) -> Self {
        Self { hint, ..self }
    }
}

const NIGHTLY: &str = "rustup toolchain install nightly --component rust-src,clippy\n\
                       or name one: SINGLETRACK_RUSTC=/path/to/rustc";

/// Prerequisites of every check.
#[rustfmt::skip]
const BASIC: [Prerequisite; 3] = [
    row(&[], "rustfmt", "", "${CARGO:-cargo} fmt --version")
        .or("rustup component add rustfmt\nor, with Debian's Rust: apt-get install rustfmt-web"),
    row(&[], "clippy", "",
        "clippy=$(${CARGO:-cargo} clippy --version); rustc=$(${RUSTC:-rustc} --version)
         [ $(echo $clippy | cut -d. -f3 | cut -d' ' -f1) = $(minor \"$rustc\") ] ||
         fail $clippy does not match $rustc
         echo $clippy")
        .or("rustup component add clippy\nor, with Debian's Rust: apt-get install rust-web-clippy"),
    row(&[], "C compiler", "gcc libc6-dev",
        "links \"${CC:-cc}\" 'int main(void) { return puts(\"\") < 0; }' -include stdio.h
         echo ${CC:-cc} links a program"),
];

/// Prerequisites of `cargo uno` and of everything that runs the image.
#[rustfmt::skip]
pub(crate) const IMAGE: [Prerequisite; 3] = [
    row(&[Uno], "Rust for the Arduino", "rustc-web rust-web-src", AVR).or(NIGHTLY),
    row(&[Uno], "C and binutils for the Arduino", "gcc-avr avr-libc binutils-avr",
        "links avr-gcc 'int main(void) { return PORTB; }' -include avr/io.h -mmcu=atmega328p
         avr-gcc --version; avr-nm --version; avr-size --version; avr-objcopy --version"),
    // The static library, as in the simulator.
    row(&[Uno], "simavr", "libsimavr-dev libelf-dev",
        "links \"${CC:-cc}\" 'int main(void) { return !avr_make_mcu_by_name(\"atmega328p\"); }' \
            -I/usr/include/simavr -include sim_avr.h -l:libsimavr.a -lelf
         ./probe || fail a program can not make an ATmega328P
         echo creates an ATmega328P"),
];

/// A compiler as for the image, with clippy of the same release.
pub(crate) const AVR_CLIPPY: &str = "compiler avr-none core clippy";

/// Prerequisites of `cargo odroid`.
#[rustfmt::skip]
pub(crate) const ODROID: [Prerequisite; 2] = [
    row(&[Odroid], "Rust for the Odroid", "rustc-web rust-web-src", ARMHF.probe).or(NIGHTLY),
    row(&[Odroid], "C for the Odroid", "gcc-arm-linux-gnueabihf libc6-dev-armhf-cross",
        "links arm-linux-gnueabihf-gcc 'int main(void) { exit(0); }' -include stdlib.h
         arm-linux-gnueabihf-gcc --version"),
];

/// What runs the Odroid's programs here.
#[rustfmt::skip]
pub(crate) const EMULATOR: Prerequisite =
    row(&[Odroid], "qemu", "qemu-user-static gcc-arm-linux-gnueabihf libc6-dev-armhf-cross",
        "emulates arm-linux-gnueabihf qemu-arm-static");

/// Prerequisites of `cargo deb --target arm64`.
#[rustfmt::skip]
pub(crate) const ARM64: [Prerequisite; 2] = [
    row(&[], "Rust for ARM64", "rustc-web rust-web-src", AARCH64.probe).or(NIGHTLY),
    row(&[], "C and qemu for ARM64",
        "gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user-static",
        "emulates aarch64-linux-gnu qemu-aarch64-static"),
];

/// Prerequisites of `cargo deb` on every machine; the image is in the package.
#[rustfmt::skip]
pub(crate) const PACKAGE: [Prerequisite; 2] = [
    row(&[Debian], "debhelper", "debhelper",
        "for tool in dpkg-architecture dpkg-deb man; do $tool --version >/dev/null; done
         dh --list | grep -x installsysusers ||
         fail dh lacks installsysusers, which debhelper has since 13.11"),
    row(&[Debian], "lintian", "lintian", "lintian --version"),
];

/// What knows whether a checkout is clean, and what makes a container image.
pub(crate) const GIT: Prerequisite = row(&[], "git", "git", "git --version");
pub(crate) const PODMAN: Prerequisite = row(&[], "podman", "podman", "podman --version");

/// What writes the image to the Arduino.
pub(crate) const PROGRAMMER: Prerequisite = row(&[Uno], "avrdude", "avrdude", "avrdude '-?'");

/// Prerequisites of single parts.
#[rustfmt::skip]
const OTHERS: [Prerequisite; 7] = [
    row(&[Uno], "clippy for the Arduino", "rustc-web rust-web-src rust-web-clippy", AVR_CLIPPY)
        .or(NIGHTLY),
    row(&[Readers, Python], "Python", "python3 python3-venv", "find_python"),
    row(&[Ros], "Python for ROS", "python3 python3-venv python3-dev g++ iproute2 util-linux",
        "python=$(find_python)
         $python -c 'import os, sys, sysconfig
assert sys.version_info < (3, 14), \"there is a rclpy up to 3.13\"
header = sysconfig.get_paths()[\"include\"] + \"/Python.h\"
assert os.path.exists(header), header + \" is missing\"'
         $python --version; c++ --version; unshare --map-root-user --net ip link"),
    row(&[Octave], "Octave", "octave octave-instrument-control",
        "octave-cli --quiet --no-history --no-init-file --eval \"pkg load instrument-control;
         jsondecode('1'); assert(exist('tcpclient') > 0); disp(OCTAVE_VERSION)\""),
    row(&[Browser], "Chromium", "chromium", "chromium --headless --version"),
    // The path of a user may lack the folder of the daemons. Without a cluster, sbatch does not
    // even print its version.
    row(&[Slurm], "Slurm", "munge slurmctld slurmd slurm-client iproute2 util-linux",
        "PATH=$PATH:/usr/sbin
         slurmctld -V; munged --version; slurmd -V; command -v sbatch
         unshare --map-root-user --net ip link"),
    // The unit reloads the daemon by /bin/kill.
    row(&[Units], "systemd-analyze", "systemd procps",
        "version=$(systemd-analyze --version | sed -n '1s/systemd \\([0-9]*\\).*/\\1/p')
         [ \"$version\" -ge 250 ] || fail systemd ${version:-}, not 250 or later
         [ -x /bin/kill ] || fail no /bin/kill, which the unit uses
         echo systemd $version"),
];

/// Prerequisites of the checks with these parts.
pub(crate) fn of_parts(parts: &[Part]) -> Vec<Prerequisite> {
    let all = [&BASIC[..], &IMAGE, &ODROID, &[EMULATOR], &OTHERS, &PACKAGE].concat();
    all.into_iter()
        .filter(|one| one.parts.is_empty() || one.parts.iter().any(|part| parts.contains(part)))
        .collect()
}

/// Probes the prerequisites, installs or upgrades the packages of those that are not met, and probes
/// these again. Fails with one message about all that remain.
pub(crate) fn ensure(required: &[Prerequisite]) -> Result<(), Failure> {
    ensure_by(required, &|script| answer(&mut shell(script)))
}

/// A Python that creates environments.
pub(crate) fn python() -> Result<PathBuf, Failure> {
    let python = answer(&mut shell("find_python")).map_err(Failure::Failed)?;
    Ok(python.into())
}

type Run<'a> = &'a dyn Fn(&str) -> Result<String, String>;

fn ensure_by(required: &[Prerequisite], run: Run<'_>) -> Result<(), Failure> {
    let mut short = probe(required, run);
    let mut packages: Vec<&str> = Vec::new();
    for package in short.iter().flat_map(|(one, _)| one.packages().split(' ')) {
        if !package.is_empty() && !packages.contains(&package) {
            packages.push(package);
        }
    }
    let mut installed = Ok(String::new());
    if !packages.is_empty() {
        let packages = packages.join(" ");
        eprintln!("Installing Debian packages: {packages}");
        installed = run(&format!("install_packages {packages}"));
        let again: Vec<Prerequisite> = short.iter().map(|(one, _)| *one).collect();
        short = probe(&again, run);
    }
    if short.is_empty() {
        return Ok(());
    }
    Err(Failure::Failed(message(&short, installed.err())))
}

/// Prints what was found, and returns the prerequisites that are not met with the reasons.
fn probe(required: &[Prerequisite], run: Run<'_>) -> Vec<(Prerequisite, String)> {
    let mut short = Vec::new();
    for one in required {
        let found = run(one.probe);
        let (Ok(text) | Err(text)) = &found;
        let line = text.lines().next().unwrap_or("it works");
        eprintln!("{}: {line}", one.name);
        if let Err(why) = found {
            short.push((*one, why));
        }
    }
    short
}

impl Prerequisite {
    /// The Debian packages that help on this machine: none replaces a named compiler.
    fn packages(&self) -> &'static str {
        let named = env::var_os("SINGLETRACK_RUSTC").is_some_and(|rustc| !rustc.is_empty());
        let is_rust = self.packages.starts_with("rustc-web");
        if named && is_rust { "" } else { self.packages }
    }
}

/// The message: what was found, and how to get what is needed.
fn message(short: &[(Prerequisite, String)], trouble: Option<String>) -> String {
    /// More lines of a compiler's errors do not help.
    const LINES: usize = 8;
    let mut text = format!("{} prerequisites are not met\n", short.len());
    for (one, found) in short {
        let indented = |text: &str| {
            let lines: Vec<&str> = text.lines().take(LINES).collect();
            lines.join("\n             ")
        };
        let _ = write!(text, "\n  {}\n    found    {}\n", one.name, indented(found));
        if !one.packages().is_empty() {
            let _ = writeln!(
                text,
                "    get it   apt-get update && apt-get install {}   (Debian 12)",
                one.packages()
            );
        }
        if !one.hint.is_empty() {
            let _ = writeln!(text, "    get it   {}", indented(one.hint));
        }
    }
    if let Some(trouble) = trouble {
        let _ = write!(text, "\n{trouble}\n");
    }
    text.push_str(
        "\npackaging/Containerfile describes a Debian 12 image with all of them, and its use.\n",
    );
    let parts: Vec<&str> = Part::ALL
        .into_iter()
        .filter(|part| short.iter().any(|(one, _)| one.parts.contains(part)))
        .map(Part::name)
        .collect();
    if !parts.is_empty() {
        let _ = writeln!(
            text,
            "To skip the checks that need them: cargo verify --without {}",
            parts.join(",")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use std::{fs, path::Path, process::Command};

    use super::*;

    /// A machine with stand-ins, which are shell scripts, and with the programs that the functions
    /// of the probes call.
    struct Machine(PathBuf);

    impl Machine {
        fn new(test: &str) -> Self {
            let name = format!("singletrack-xtask-{test}-{}", std::process::id());
            let machine = Self(env::temp_dir().join(name));
            let _ = fs::remove_dir_all(&machine.0);
            machine.sh(
                "mkdir -p \"$1/bin\"
                 for tool in cat cut env grep mktemp rm sed sh sort tail; do
                     ln -s \"$(command -v $tool)\" \"$1/bin\"
                 done",
                "",
            );
            machine.program("bin/id", "echo 0");
            machine.program("bin/sleep", "");
            machine
        }

        /// Runs a script with the machine's folder and a text.
        fn sh(&self, script: &str, text: &str) {
            let mut sh = Command::new("/bin/sh");
            let status = sh
                .args(["-ec", script, "sh"])
                .arg(&self.0)
                .arg(text)
                .status();
            assert!(status.unwrap().success());
        }

        /// Written by another process: a file that is open for writing in this one could be
        /// inherited by a program of another test, and could then not be executed.
        fn program(&self, place: &str, script: &str) -> String {
            let write = format!(
                "mkdir -p $(dirname \"$1/{place}\"); printf '#!/bin/sh\\n%s\\n' \"$2\" >\"$1/{place}\"
                 chmod 755 \"$1/{place}\""
            );
            self.sh(&write, script);
            self.0.join(place).to_str().unwrap().to_owned()
        }

        /// An apt-get that logs its calls, with a script for the rest.
        fn apt(&self, script: &str) {
            let calls = self.0.join("calls");
            let log = format!("echo \"$*\" >>'{}'\n{script}", calls.display());
            self.program("bin/apt-get", &log);
        }

        /// What apt-get was to update and to install.
        fn calls(&self) -> Vec<String> {
            let calls = fs::read_to_string(self.0.join("calls")).unwrap_or_default();
            let after = |line: &str| line.split_once("https::Timeout=8 ").unwrap().1.to_owned();
            calls.lines().map(after).collect()
        }

        /// A rustc of a release that compiles for this target, with the sources of a library.
        fn rustc(&self, folder: &str, release: &str, target: &str, library: &str) -> String {
            let sysroot = self.0.join(folder);
            let sources = sysroot.join("lib/rustlib/src/rust/library").join(library);
            fs::create_dir_all(sources.join("src")).unwrap();
            fs::write(sources.join("src/lib.rs"), "").unwrap();
            self.program(
                &format!("{folder}/bin/rustc"),
                &format!(
                    "case \"$*\" in
                     *--target*{target}*) exit 0 ;;
                     *--target*) echo 'error: no back end' >&2; exit 1 ;;
                     '-vV') echo 'release: {release}' ;;
                     '--print sysroot') echo '{}' ;;
                     esac",
                    sysroot.display()
                ),
            )
        }

        fn run(&self, script: &str) -> Result<String, String> {
            let mut shell = shell(script);
            answer(
                shell
                    .env("PATH", self.0.join("bin"))
                    .env_remove("SINGLETRACK_RUSTC"),
            )
        }

        /// Searches a compiler, with Debian's in this place; returns its path, and its cargo.
        fn compiler(&self, debian: &str, script: &str) -> Result<Vec<String>, String> {
            let debian = self.0.join(debian).join("bin/rustc");
            let found = self.run(&format!("debian='{}'; {script}", debian.display()))?;
            Ok(found.lines().skip(1).map(str::to_owned).collect())
        }

        fn ensure(&self, required: &[Prerequisite]) -> Result<(), String> {
            ensure_by(required, &|script| self.run(script)).map_err(|why| why.to_string())
        }
    }

    impl Drop for Machine {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    const ONE: Prerequisite =
        row(&[Uno], "one", "gcc-one lib-one", "command -v one").or("build it");
    const TWO: Prerequisite = row(&[Slurm], "two", "two lib-one", "command -v two");

    #[test]
    fn missing_packages_are_installed_at_once_from_refreshed_lists() {
        let machine = Machine::new("install");
        let [one, two] = ["bin/one", "bin/two"].map(|name| machine.0.join(name));
        machine.apt(&format!(
            "case \"$*\" in *install*) printf x >'{0}'; printf x >'{1}'; chmod +x '{0}' '{1}' ;; esac",
            one.display(),
            two.display()
        ));
        machine.sh("ln -s \"$(command -v chmod)\" \"$1/bin\"", "");
        machine.ensure(&[ONE, TWO]).unwrap();
        assert_eq!(
            machine.calls(),
            ["update --error-on=any", "install gcc-one lib-one two"]
        );
        machine.ensure(&[ONE, TWO]).unwrap();
        assert_eq!(
            machine.calls().len(),
            2,
            "what works is not installed again"
        );
    }

    #[test]
    fn unmet_prerequisites_are_reported_with_a_fix() {
        let machine = Machine::new("short");
        // Another program holds the lists for a moment.
        machine.apt(&format!(
            "case \"$*\" in
             *update*) [ -e '{0}' ] || {{ : >'{0}'; echo 'E: Could not get lock x'; exit 100; }} ;;
             *gcc-one*) echo 'E: Unable to locate package gcc-one' >&2; exit 100 ;;
             esac",
            machine.0.join("locked").display()
        ));
        let why = machine.ensure(&[ONE, TWO]).unwrap_err();
        for part in [
            "2 prerequisites are not met",
            "  one\n    found    ",
            "get it   apt-get update && apt-get install gcc-one lib-one   (Debian 12)\n",
            "get it   build it\n",
            "\napt-get install: E: Unable to locate package gcc-one\n",
            "packaging/Containerfile",
            "cargo verify --without uno,slurm\n",
        ] {
            assert!(why.contains(part), "{part}\n{why}");
        }
        assert!(!why.contains("lock"), "{why}");
        // One package that does not exist does not prevent the others.
        let calls = machine.calls();
        assert_eq!(
            calls[2..],
            [
                "install gcc-one lib-one two",
                "install gcc-one",
                "install lib-one",
                "install two"
            ]
        );
    }

    #[test]
    fn without_network_apt_or_rights_the_reason_is_reported() {
        let machine = Machine::new("offline");
        let why = machine.ensure(&[ONE]).unwrap_err();
        assert!(why.contains("There is no apt-get here"), "{why}");
        machine.apt("echo 'W: old'; echo \"E: Failed to fetch for $*\"; exit 100");
        let why = machine.ensure(&[ONE]).unwrap_err();
        assert!(why.contains("apt-get update: E: Failed to fetch"), "{why}");
        assert!(!why.contains("W: "), "{why}");
        assert_eq!(
            machine.calls().len(),
            2,
            "no more downloads, which would fail too"
        );
        machine.program("bin/id", "echo 1000");
        let why = machine.ensure(&[ONE]).unwrap_err();
        assert!(why.contains("by hand"), "{why}");
        machine.program(
            "bin/sudo",
            "[ \"$1\" = -n ] && shift && { [ \"$1\" = true ] || exec \"$@\"; }",
        );
        let why = machine.ensure(&[ONE]).unwrap_err();
        assert!(why.contains("apt-get update: E: Failed to fetch"), "{why}");
    }

    #[test]
    fn the_first_compiler_that_works_is_used() {
        let machine = Machine::new("compilers");
        let debians = machine.rustc("debian", "1.96.0", "avr-none", "core");
        let found = |script: &str| machine.compiler("debian", script);
        assert_eq!(found(AVR).unwrap(), [debians.as_str()]);
        // A nightly comes before, once it has the sources.
        let nightly = machine.rustc("nightly", "1.99.0-nightly", "avr-none", "alloc");
        machine.program(
            "bin/rustup",
            &format!(
                "case \"$*\" in
                 'toolchain list') echo 'stable (active, default)'; echo 'nightly-x (override)' ;;
                 'which --toolchain nightly-x rustc') echo '{nightly}' ;;
                 *) exit 1 ;;
                 esac"
            ),
        );
        assert_eq!(found(AVR).unwrap(), [debians.as_str()]);
        machine.rustc("nightly", "1.99.0-nightly", "avr-none", "core");
        assert_eq!(found(AVR).unwrap(), [nightly.as_str()]);
        // Its cargo if that is of the same release.
        machine.program("nightly/bin/cargo", "echo 'release: 0.66.0'");
        assert_eq!(found(AVR).unwrap(), [nightly.as_str()]);
        let cargo = machine.program("nightly/bin/cargo", "echo 'release: 1.99.0'");
        assert_eq!(found(AVR).unwrap(), [nightly.clone(), cargo]);
        // With its clippy.
        let why = found(AVR_CLIPPY).unwrap_err();
        assert!(
            why.contains("nightly/bin/clippy-driver is of rustc (it does not run)"),
            "{why}"
        );
        machine.program("debian/bin/clippy-driver", "echo 'release: 1.85.0'");
        let why = found(AVR_CLIPPY).unwrap_err();
        assert!(
            why.contains("is of rustc 1.85.0, the compiler is 1.96.0"),
            "{why}"
        );
        machine.program("debian/bin/clippy-driver", "echo 'release: 1.96.0'");
        assert_eq!(found(AVR_CLIPPY).unwrap(), [debians.as_str()]);
        // A named compiler is not replaced.
        let named = |rustc: &str| found(&format!("SINGLETRACK_RUSTC='{rustc}'; {AVR}"));
        let mine = machine.rustc("mine", "1.97.0", "avr-none", "core");
        assert_eq!(named(&mine).unwrap(), [mine.as_str()]);
        machine.rustc("mine", "1.97.0", "none-of-ours", "core");
        let why = named(&mine).unwrap_err();
        assert!(
            why.ends_with("can't compile for avr-none: error: no back end"),
            "{why}"
        );
        let why = named("/no/such/rustc").unwrap_err();
        assert_eq!(
            why,
            "SINGLETRACK_RUSTC names /no/such/rustc, which does not run"
        );
    }

    #[test]
    fn unsuitable_compilers_are_reported_with_what_they_lack() {
        let machine = Machine::new("unsuitable");
        let lack = |script| machine.compiler("debian", script).unwrap_err();
        assert!(lack(AVR).ends_with("debian/bin/rustc does not run"));
        machine.rustc("debian", "1.85.0", "avr-none", "core");
        assert!(
            lack(AVR).ends_with("rustc 1.85.0, is older than 1.95"),
            "{}",
            lack(AVR)
        );
        machine.rustc("debian", "1.100.0", "avr-none", "core");
        machine.compiler("debian", AVR).unwrap();
        assert!(lack(ARMHF.probe).contains("can't compile for armv7-unknown-linux-gnueabihf"));
        machine.rustc("debian", "1.96.0", "armv7", "core");
        assert!(lack(ARMHF.probe).contains("lacks the sources of std"));
        machine.rustc("debian", "1.96.0", "armv7", "std");
        machine.compiler("debian", ARMHF.probe).unwrap();
    }

    #[test]
    fn programs_are_tried_and_not_only_looked_for() {
        let machine = Machine::new("programs");
        let rows = of_parts(&Part::ALL);
        let attempt = |name: &str| {
            let row = rows.iter().find(|row| row.name == name).unwrap();
            machine.run(row.probe)
        };
        let lacks = |name: &str, why: &str| {
            let found = attempt(name).unwrap_err();
            assert!(found.contains(why), "{name}: {found}");
        };
        lacks("systemd-analyze", "systemd-analyze: not found");
        machine.program("bin/systemd-analyze", "echo 'systemd 247 (247.3-7)'");
        lacks("systemd-analyze", "systemd 247, not 250 or later");
        machine.program("bin/systemd-analyze", "echo 'systemd 252 (252.38-1)'");
        assert_eq!(
            attempt("systemd-analyze").is_ok(),
            Path::new("/bin/kill").exists()
        );

        for tool in ["bin/dpkg-architecture", "bin/dpkg-deb", "bin/man"] {
            lacks("debhelper", "not found");
            machine.program(tool, "");
        }
        machine.program("bin/dh", "echo systemd");
        lacks("debhelper", "dh lacks installsysusers");
        machine.program("bin/dh", "echo installsysusers; echo systemd");
        attempt("debhelper").unwrap();

        lacks("qemu", "arm-linux-gnueabihf-gcc: not found");
        machine.program("bin/arm-linux-gnueabihf-gcc", "");
        attempt("C for the Odroid").unwrap();
        machine.program("bin/qemu-arm-static", "exit 1");
        lacks("qemu", "qemu-arm-static does not run a program: status 1");
        machine.program("bin/qemu-arm-static", "[ \"$1\" = --version ] || exit 42");
        attempt("qemu").unwrap();

        machine.program(
            "bin/avr-gcc",
            "echo 'avr/io.h: error: No such file' >&2; exit 1",
        );
        lacks("C and binutils for the Arduino", "avr/io.h: error");
        machine.program("bin/avr-gcc", "");
        lacks("C and binutils for the Arduino", "avr-nm: not found");
    }

    #[test]
    fn only_the_selected_parts_have_prerequisites() {
        let names = |parts: &[Part]| {
            of_parts(parts)
                .iter()
                .map(|one| one.name)
                .collect::<Vec<_>>()
        };
        assert_eq!(names(&[]), ["rustfmt", "clippy", "C compiler"]);
        assert!(names(&[Uno]).contains(&"simavr"));
        assert!(!names(&[Odroid, Units]).contains(&"simavr"));
        assert!(names(&[Python]).contains(&"Python"));
    }

    #[test]
    fn the_container_has_all_packages() {
        let recipe = crate::workspace::root().join("packaging/Containerfile");
        let recipe = fs::read_to_string(recipe).unwrap();
        let words: Vec<&str> = recipe.split_whitespace().collect();
        for one in of_parts(&Part::ALL)
            .iter()
            .chain([&PROGRAMMER])
            .chain(&ARM64)
        {
            for package in one.packages.split_whitespace() {
                assert!(words.contains(&package), "{package}");
            }
        }
    }
}
