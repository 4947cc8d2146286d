//! Compilers for Arduino, Odroid and other ARM computers, and what runs their programs here.
//! They need nightly features and the sources of the standard library.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    prerequisites,
    process::Result,
    target,
    workspace::{cargo_here, root},
};

/// Searches the compiler for the Arduino's processor.
pub(crate) const AVR: &str = "compiler avr-none core";

/// Searches that compiler with clippy of the same release.
pub(crate) const AVR_CLIPPY: &str = "compiler avr-none core clippy";

/// A processor with Linux.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Target {
    pub(crate) triple: &'static str,
    /// Debian's name of the architecture.
    pub(crate) architecture: &'static str,
    /// Prefix of the C compiler, and the folder of its libraries.
    gnu: &'static str,
    /// The emulator.
    qemu: &'static str,
}

/// The Odroid, and 32-bit systems on a Raspberry Pi.
pub(crate) const ARMHF: Target = Target {
    triple: "armv7-unknown-linux-gnueabihf",
    architecture: "armhf",
    gnu: "arm-linux-gnueabihf",
    qemu: "qemu-arm-static",
};

/// 64-bit systems on a Raspberry Pi and other ARM computers.
pub(crate) const AARCH64: Target = Target {
    triple: "aarch64-unknown-linux-gnu",
    architecture: "arm64",
    gnu: "aarch64-linux-gnu",
    qemu: "qemu-aarch64-static",
};

/// A compiler that builds for a target.
#[derive(Debug)]
pub(crate) struct Compiler {
    rustc: PathBuf,
    /// Cargo of the same release, if any.
    cargo: Option<PathBuf>,
}

impl Compiler {
    /// The first that works: the one that `SINGLETRACK_RUSTC` names, a nightly of rustup with
    /// `rust-src`, Debian's. The probe is one such as [`AVR`].
    pub(crate) fn find(probe: &str) -> Result<Self> {
        let found = prerequisites::find(probe)?;
        let mut paths = found.lines().skip(1).map(PathBuf::from);
        Ok(Self {
            rustc: paths.next().unwrap_or_default(),
            cargo: paths.next(),
        })
    }

    /// Its clippy.
    pub(crate) fn clippy(&self) -> PathBuf {
        self.rustc.with_file_name("clippy-driver")
    }

    /// Cargo in a folder, without environment variables that would change the program: the tested
    /// program is the one that is flashed or installed.
    pub(crate) fn cargo(&self, folder: &Path) -> Command {
        let mut cargo = self.cargo.as_ref().map_or_else(cargo_here, Command::new);
        self.set_up(cargo.current_dir(folder));
        cargo
    }

    /// Gives cargo, or a program that calls it, this compiler and the environment of
    /// [`Compiler::cargo`].
    fn set_up(&self, command: &mut Command) {
        for (name, _) in env::vars_os() {
            if name.to_str().is_some_and(changes_a_build) {
                command.env_remove(name);
            }
        }
        command
            .envs(self.cargo.as_ref().map(|cargo| ("CARGO", cargo)))
            // Empty overrides the user's configuration, too.
            .envs([("RUSTC_WRAPPER", ""), ("RUSTC_WORKSPACE_WRAPPER", "")])
            // Enables unstable options, such as building the standard library.
            .env("RUSTC", &self.rustc)
            .env("RUSTC_BOOTSTRAP", "1");
    }
}

/// Whether an environment variable could change the program.
fn changes_a_build(name: &str) -> bool {
    const HARMLESS: &str = "HOME HTTP_ NET_ REGISTR SOURCE_ TERM_ BUILD_JOBS";
    let of_cargo = name.strip_prefix("CARGO_");
    name == "RUSTFLAGS"
        || of_cargo.is_some_and(|name| !HARMLESS.split(' ').any(|start| name.starts_with(start)))
}

impl Target {
    /// The words before a program that let it run in the emulator: where it finds the C library.
    pub(crate) fn emulator(&self) -> String {
        format!("{} -L /usr/{}", self.qemu, self.gnu)
    }

    fn compiler(&self) -> Result<Compiler> {
        Compiler::find(&format!("compiler {} std", self.triple))
    }

    /// `cargo build` for this processor, and the folder of the programs of a profile.
    pub(crate) fn build(&self, profile: &str) -> Result<(Command, PathBuf)> {
        let mut cargo = self.compiler()?.cargo(root());
        let folder = self.set_up(cargo.arg("build"), profile)?;
        Ok((cargo, folder))
    }

    /// Lets maturin build for this processor.
    pub(crate) fn maturin_build(&self, maturin: &mut Command) -> Result {
        self.compiler()?.set_up(maturin);
        self.set_up(maturin.arg("build"), "release").map(drop)
    }

    fn set_up(&self, command: &mut Command, profile: &str) -> Result<PathBuf> {
        let gcc = format!("{}-gcc", self.gnu);
        cross(command, self.triple, profile, "panic_unwind", [&gcc; 2])
    }
}

/// Adds the arguments of a build for another processor by cargo, or by maturin, which has the same. The
/// standard library is built from its sources. Returns the folder of the programs.
pub(crate) fn cross(
    command: &mut Command,
    triple: &str,
    profile: &str,
    panics: &str,
    [linker, c_compiler]: [&str; 2],
) -> Result<PathBuf> {
    // Those for Linux and for a browser share what runs while compiling.
    let folder = target::folder()?.join("cross");
    let name = triple.replace('-', "_");
    let of_linker = format!("CARGO_TARGET_{}_LINKER", name.to_uppercase());
    command
        .env(of_linker, linker)
        // zstd is C.
        .env(format!("CC_{name}"), c_compiler)
        .args(["--locked", "--profile", profile, "--target", triple])
        .arg(format!("-Zbuild-std=std,{panics}"))
        .arg("--target-dir")
        .arg(&folder);
    if profile != "release" {
        // No trace of a panic, which takes a third of the standard library.
        command.arg("-Zbuild-std-features=panic-unwind");
    }
    Ok(folder.join(triple).join(profile))
}

#[cfg(test)]
mod tests {
    use super::changes_a_build;

    #[test]
    fn variables_that_change_a_build_are_recognised() {
        for name in [
            "RUSTFLAGS",
            "CARGO_ENCODED_RUSTFLAGS",
            "CARGO_BUILD_TARGET",
            "CARGO_PROFILE_RELEASE_OPT_LEVEL",
            "CARGO_TARGET_DIR",
            "CARGO_UNSTABLE_BUILD_STD",
        ] {
            assert!(changes_a_build(name), "{name}");
        }
        for name in [
            "PATH",
            "CARGO",
            "CARGO_HOME",
            "CARGO_NET_OFFLINE",
            "CARGO_REGISTRIES_X_INDEX",
        ] {
            assert!(!changes_a_build(name), "{name}");
        }
    }
}
