//! Prerequisites of the checks, which `prerequisites.sh` probes and installs; the compilers for Arduino,
//! Odroid and other ARM computers, and what runs their programs here. They need nightly features and the
//! sources of the standard library.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    process::{Result, check, failure, require},
    workspace::{cargo, cargo_here, root, target},
};

/// The optional parts of the checks, with their prerequisites in `prerequisites.sh`.
pub(crate) const PARTS: [&str; 12] = [
    // The Arduino's image, and the simulated Arduino that runs it.
    "uno",     // The build for the Odroid, emulated.
    "odroid",  // Readers of records in Python.
    "readers", // The Python package.
    "python",  // ROS 2 in Python.
    "ros",     // Cars on other computers by way of a zenoh router.
    "zenoh",   // Octave, for MATLAB's language.
    "octave",  // The page in a browser.
    "browser", // The laboratory in a browser.
    "web",     // Campaigns on a cluster.
    "slurm",   // systemd's verification of the service.
    "units",   // The Debian package.
    "debian",
];

/// Probes what parts of `prerequisites.sh` need, and installs or upgrades the packages of what is not
/// met. Fails with one message about all that remains.
pub(crate) fn ensure(parts: impl IntoIterator<Item: AsRef<OsStr>>) -> Result {
    answer(script("ensure").args(parts)).map(drop)
}

/// What a probe of `prerequisites.sh` prints.
pub(crate) fn find(probe: &str) -> Result<String> {
    answer(script("find").args(probe.split(' ')))
}

fn script(function: &str) -> Command {
    let mut script = Command::new(root().join("xtask/src/prerequisites.sh"));
    script.arg(function).stderr(Stdio::inherit());
    script
}

/// What a script prints; its failure, if it fails.
fn answer(script: &mut Command) -> Result<String> {
    let output = script.stdin(Stdio::null()).output();
    let output = output.map_err(|error| failure!("prerequisites.sh does not start: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    require!(output.status.success(), "{}", text.trim_end());
    Ok(text.trim_end().to_owned())
}

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
    pub(crate) rustc: PathBuf,
    /// Cargo of the same release, if any.
    cargo: Option<PathBuf>,
}

impl Compiler {
    /// The first that works: the one that `SINGLETRACK_RUSTC` names, a nightly of rustup with
    /// `rust-src`, Debian's. The probe is one such as [`AVR`].
    pub(crate) fn find(probe: &str) -> Result<Self> {
        let found = find(probe)?;
        let mut paths = found.lines().skip(1).map(PathBuf::from);
        Ok(Self {
            rustc: paths.next().unwrap_or_default(),
            cargo: paths.next(),
        })
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
        let set = env::vars_os().filter_map(|(name, _)| name.into_string().ok());
        for name in set.filter(|name| changes_a_build(name)) {
            command.env_remove(name);
        }
        command.envs(self.cargo.as_ref().map(|cargo| ("CARGO", cargo)));
        // Empty overrides the user's configuration, too.
        command.envs([("RUSTC_WRAPPER", ""), ("RUSTC_WORKSPACE_WRAPPER", "")]);
        // Enables unstable options, such as building the standard library.
        command
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

/// Builds programs as for an installation, for another processor or for this machine; returns their
/// folder.
pub(crate) fn release_build(foreign: Option<Target>, options: &[&str]) -> Result<PathBuf> {
    let here = || Ok((cargo("build --release --locked"), target()?.join("release")));
    let (mut cargo, folder) = foreign.map_or_else(here, |foreign| foreign.build("release"))?;
    check(cargo.args(options).stdout(Stdio::null()))?;
    Ok(folder)
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
    let folder = target()?.join("cross");
    let name = triple.replace('-', "_");
    let of_linker = format!("CARGO_TARGET_{}_LINKER", name.to_uppercase());
    command.env(of_linker, linker);
    // zstd is C.
    command.env(format!("CC_{name}"), c_compiler);
    command.args(["--locked", "--profile", profile, "--target", triple]);
    command.arg(format!("-Zbuild-std=std,{panics}"));
    command.arg("--target-dir").arg(&folder);
    if profile != "release" {
        // No trace of a panic, which takes a third of the standard library.
        command.arg("-Zbuild-std-features=panic-unwind");
    }
    Ok(folder.join(triple).join(profile))
}

#[cfg(test)]
mod tests;
