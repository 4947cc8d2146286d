//! The list of prerequisites.

use super::{
    Part, Prerequisite,
    attempt::{
        c_compiler, clippy, debhelper, emulator, image_clippy, image_linker, linker, octave,
        of_this_toolchain, python, ros, runs, rust, simavr, slurm, systemd,
    },
};
use crate::{
    compiler::AVR,
    foreign::{AARCH64, ARMHF},
};

pub(crate) const FORMATTER: Prerequisite = Prerequisite {
    name: "rustfmt",
    needed: "cargo fmt",
    packages: &[],
    otherwise: "rustup component add rustfmt\nor, with Debian's Rust: apt-get install rustfmt-web",
    part: None,
    attempt: |machine| of_this_toolchain(machine, "fmt"),
};

pub(crate) const CLIPPY: Prerequisite = Prerequisite {
    name: "clippy",
    needed: "cargo clippy of the release of rustc",
    packages: &[],
    otherwise: "rustup component add clippy\nor, with Debian's Rust: apt-get install rust-web-clippy",
    part: None,
    attempt: clippy,
};

pub(crate) const C_COMPILER: Prerequisite = Prerequisite {
    name: "C compiler",
    needed: "cc (or the one that CC names) links a program",
    packages: &["gcc", "libc6-dev"],
    otherwise: "",
    part: None,
    attempt: c_compiler,
};

pub(crate) const IMAGE_COMPILER: Prerequisite = Prerequisite {
    name: AVR.name,
    needed: concat!(
        "a rustc ",
        env!("CARGO_PKG_RUST_VERSION"),
        " or later that compiles for avr-none, with the sources of core"
    ),
    packages: &["rustc-web", "rust-web-src"],
    otherwise: "rustup toolchain install nightly --component rust-src,clippy\n\
                or name one: SINGLETRACK_RUSTC=/path/to/rustc",
    part: Some(Part::Uno),
    attempt: |machine| rust(machine, AVR),
};

pub(crate) const IMAGE_CLIPPY: Prerequisite = Prerequisite {
    name: "clippy for the Arduino",
    needed: "the clippy-driver of the rustc that builds the image",
    packages: &["rust-web-clippy"],
    otherwise: "rustup component add clippy --toolchain nightly",
    part: Some(Part::Uno),
    attempt: image_clippy,
};

pub(crate) const IMAGE_LINKER: Prerequisite = Prerequisite {
    name: "C and binutils for the Arduino",
    needed: "avr-gcc links a program for the ATmega328P; avr-nm, avr-size, avr-objcopy",
    packages: &["gcc-avr", "avr-libc", "binutils-avr"],
    otherwise: "",
    part: Some(Part::Uno),
    attempt: image_linker,
};

pub(crate) const SIMULATOR: Prerequisite = Prerequisite {
    name: "simavr",
    needed: "a program linked with simavr creates an ATmega328P",
    packages: &["libsimavr-dev", "libelf-dev"],
    otherwise: "",
    part: Some(Part::Uno),
    attempt: simavr,
};

pub(crate) const ODROID_COMPILER: Prerequisite = Prerequisite {
    name: ARMHF.rust.name,
    needed: concat!(
        "a rustc ",
        env!("CARGO_PKG_RUST_VERSION"),
        " or later that compiles for armv7-unknown-linux-gnueabihf, with the sources of std"
    ),
    packages: &["rustc-web", "rust-web-src"],
    otherwise: "rustup toolchain install nightly --component rust-src\n\
                or name one: SINGLETRACK_RUSTC=/path/to/rustc",
    part: Some(Part::Odroid),
    attempt: |machine| rust(machine, ARMHF.rust),
};

pub(crate) const ODROID_LINKER: Prerequisite = Prerequisite {
    name: "C for the Odroid",
    needed: "arm-linux-gnueabihf-gcc links a program",
    packages: &["gcc-arm-linux-gnueabihf", "libc6-dev-armhf-cross"],
    otherwise: "",
    part: Some(Part::Odroid),
    attempt: |machine| linker(&ARMHF, machine),
};

pub(crate) const EMULATOR: Prerequisite = Prerequisite {
    name: "qemu",
    needed: "qemu-arm-static runs a program for the Odroid",
    packages: &["qemu-user-static"],
    otherwise: "",
    part: Some(Part::Odroid),
    attempt: |machine| emulator(&ARMHF, machine),
};

pub(crate) const ARM64_COMPILER: Prerequisite = Prerequisite {
    name: AARCH64.rust.name,
    needed: concat!(
        "a rustc ",
        env!("CARGO_PKG_RUST_VERSION"),
        " or later that compiles for aarch64-unknown-linux-gnu, with the sources of std"
    ),
    part: None,
    attempt: |machine| rust(machine, AARCH64.rust),
    ..ODROID_COMPILER
};

pub(crate) const ARM64_LINKER: Prerequisite = Prerequisite {
    name: "C for ARM64",
    needed: "aarch64-linux-gnu-gcc links a program",
    packages: &["gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross"],
    otherwise: "",
    part: None,
    attempt: |machine| linker(&AARCH64, machine),
};

pub(crate) const ARM64_EMULATOR: Prerequisite = Prerequisite {
    name: "qemu for ARM64",
    needed: "qemu-aarch64-static runs a program for ARM64",
    packages: &["qemu-user-static"],
    otherwise: "",
    part: None,
    attempt: |machine| emulator(&AARCH64, machine),
};

pub(crate) const DEBHELPER: Prerequisite = Prerequisite {
    name: "debhelper",
    needed: "dpkg-deb, dpkg-architecture, dh and dh_installsysusers of debhelper 13.11 or later",
    packages: &["debhelper"],
    otherwise: "",
    part: Some(Part::Debian),
    attempt: debhelper,
};

pub(crate) const LINTIAN: Prerequisite = Prerequisite {
    name: "lintian",
    needed: "lintian, which checks Debian packages",
    packages: &["lintian"],
    otherwise: "",
    part: Some(Part::Debian),
    attempt: |machine| runs(machine, "lintian", ["--version"]),
};

pub(crate) const SYSTEMD: Prerequisite = Prerequisite {
    name: "systemd-analyze",
    needed: "systemd 250 or later, which verifies units that are not installed; and /bin/kill",
    packages: &["systemd", "procps"],
    otherwise: "",
    part: Some(Part::Units),
    attempt: systemd,
};

pub(crate) const PYTHON: Prerequisite = Prerequisite {
    name: "Python",
    needed: "Python 3.11 or later that creates virtual environments",
    packages: &["python3", "python3-venv"],
    otherwise: "",
    part: Some(Part::Readers),
    attempt: |machine| python(machine).map(|python| python.to_string_lossy().into_owned()),
};

pub(crate) const ROS: Prerequisite = Prerequisite {
    name: "Python for ROS",
    needed: "Python 3.11 to 3.13 with virtual environments and its headers, a C++ compiler, and a \
             network namespace of our own (unshare, ip)",
    packages: &[
        "python3",
        "python3-venv",
        "python3-dev",
        "g++",
        "iproute2",
        "util-linux",
    ],
    otherwise: "",
    part: Some(Part::Ros),
    attempt: ros,
};

pub(crate) const OCTAVE: Prerequisite = Prerequisite {
    name: "Octave",
    needed: "Octave 7 or later with instrument-control, whose tcpclient connects to the daemon",
    packages: &["octave", "octave-instrument-control"],
    otherwise: "",
    part: Some(Part::Octave),
    attempt: octave,
};

pub(crate) const BROWSER: Prerequisite = Prerequisite {
    name: "Chromium",
    needed: "a chromium that runs without a screen",
    packages: &["chromium"],
    otherwise: "",
    part: Some(Part::Browser),
    attempt: |machine| runs(machine, "chromium", ["--headless", "--version"]),
};

pub(crate) const SLURM: Prerequisite = Prerequisite {
    name: "Slurm",
    needed: "munged, slurmctld, slurmd and sbatch, and a network namespace of our own (unshare, ip)",
    packages: &[
        "munge",
        "slurmctld",
        "slurmd",
        "slurm-client",
        "iproute2",
        "util-linux",
    ],
    otherwise: "",
    part: Some(Part::Slurm),
    attempt: slurm,
};

pub(crate) const PYTHON_PACKAGE: Prerequisite = Prerequisite {
    part: Some(Part::Python),
    ..PYTHON
};

pub(crate) const PROGRAMMER: Prerequisite = Prerequisite {
    name: "avrdude",
    needed: "avrdude, which writes the image to the Arduino",
    packages: &["avrdude"],
    otherwise: "",
    part: Some(Part::Uno),
    attempt: |machine| runs(machine, "avrdude", ["-?"]),
};

/// Prerequisites of every check.
pub(crate) const BASIC: [Prerequisite; 3] = [FORMATTER, CLIPPY, C_COMPILER];

/// Prerequisites of `cargo uno` and of everything that runs the image.
pub(crate) const IMAGE: [Prerequisite; 3] = [IMAGE_COMPILER, IMAGE_LINKER, SIMULATOR];

/// Prerequisites of `cargo odroid`.
pub(crate) const ODROID: [Prerequisite; 2] = [ODROID_COMPILER, ODROID_LINKER];

/// Prerequisites of `cargo deb` on every machine; the image is in the package.
pub(crate) const PACKAGE: [Prerequisite; 2] = [DEBHELPER, LINTIAN];

/// Prerequisites of `cargo deb --target armhf`.
pub(crate) const PACKAGE_ARMHF: [Prerequisite; 3] = [ODROID_COMPILER, ODROID_LINKER, EMULATOR];

/// Prerequisites of `cargo deb --target arm64`.
pub(crate) const PACKAGE_ARM64: [Prerequisite; 3] = [ARM64_COMPILER, ARM64_LINKER, ARM64_EMULATOR];

/// Prerequisites of the checks with these parts.
pub(crate) fn of_parts(parts: &[Part]) -> Vec<Prerequisite> {
    BASIC
        .into_iter()
        .chain(IMAGE)
        .chain([IMAGE_CLIPPY])
        .chain(ODROID)
        .chain([
            EMULATOR,
            SYSTEMD,
            PYTHON,
            PYTHON_PACKAGE,
            ROS,
            OCTAVE,
            BROWSER,
            SLURM,
            DEBHELPER,
            LINTIAN,
        ])
        .filter(|one| one.part.is_none_or(|part| parts.contains(&part)))
        .collect()
}
