//! Computers with another processor than this one: programs are built for them by a cross
//! compiler, and run here in an emulator.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    compiler::{self, ARM, ARM64, Target},
    cross_cargo::cross_cargo,
    machine::Machine,
    process::Failure,
    target,
    workspace::root,
};

/// A processor and Debian's C library for it.
#[derive(Clone, Copy)]
pub(crate) struct Foreign {
    /// Debian's name of the architecture.
    pub(crate) architecture: &'static str,
    pub(crate) rust: Target,
    /// Prefix of the C compiler, and the folder of its libraries.
    gnu: &'static str,
    /// The emulator.
    pub(crate) qemu: &'static str,
}

/// The Odroid, and 32-bit systems on a Raspberry Pi.
pub(crate) const ARMHF: Foreign = Foreign {
    architecture: "armhf",
    rust: ARM,
    gnu: "arm-linux-gnueabihf",
    qemu: "qemu-arm-static",
};

/// 64-bit systems on a Raspberry Pi and other ARM computers.
pub(crate) const AARCH64: Foreign = Foreign {
    architecture: "arm64",
    rust: ARM64,
    gnu: "aarch64-linux-gnu",
    qemu: "qemu-aarch64-static",
};

impl Foreign {
    /// The C compiler, which also links.
    pub(crate) fn c_compiler(&self) -> String {
        format!("{}-gcc", self.gnu)
    }

    /// The options of the emulator: where it finds the C library.
    pub(crate) fn qemu_options(&self) -> [String; 2] {
        ["-L".to_owned(), format!("/usr/{}", self.gnu)]
    }

    /// A command that runs a program in the emulator.
    pub(crate) fn emulated(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(self.qemu);
        command
            .current_dir(root())
            .args(self.qemu_options())
            .arg(program);
        command
    }

    /// `cargo build` for this processor, and the target folder of all such builds. The standard
    /// library is built from its sources.
    pub(crate) fn cargo_build(&self) -> Result<(Command, PathBuf), Failure> {
        let compiler = compiler::find(&Machine::this(), self.rust)
            .map_err(|reasons| Failure::new(reasons.join("\n")))?;
        let folder = target::folder()?.join("odroid");
        let triple = self.rust.triple.replace('-', "_");
        let mut cargo = cross_cargo(&compiler, root());
        cargo
            .env(
                format!("CARGO_TARGET_{}_LINKER", triple.to_uppercase()),
                self.c_compiler(),
            )
            // zstd is C.
            .env(format!("CC_{triple}"), self.c_compiler())
            .args(["build", "--locked"])
            .args(["-Zbuild-std=std,panic_unwind", "--target", self.rust.triple])
            .arg("--target-dir")
            .arg(&folder);
        Ok((cargo, folder))
    }

    /// The folder of the programs of a profile, in the target folder.
    pub(crate) fn programs(&self, target: &Path, profile: &str) -> PathBuf {
        target.join(self.rust.triple).join(profile)
    }
}
