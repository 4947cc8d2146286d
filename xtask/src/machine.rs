//! The programs of this machine, or stand-ins in tests.

use std::{
    env,
    ffi::OsStr,
    fs, io,
    os::unix::fs::{DirBuilderExt, MetadataExt},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::atomic::{AtomicU32, Ordering},
};

/// Variable that names the compiler for Arduino and Odroid, which is otherwise
/// searched.
pub(crate) const COMPILER_VARIABLE: &str = "SINGLETRACK_RUSTC";

/// Locations of programs and files outside the project.
#[derive(Clone, Debug)]
pub(crate) struct Machine {
    /// Replaces `PATH`.
    pub(crate) path: Option<PathBuf>,
    /// The value of [`COMPILER_VARIABLE`].
    pub(crate) named_compiler: Option<PathBuf>,
    /// Path of Debian's compiler.
    pub(crate) debian_compiler: PathBuf,
    /// Folder of apt's package lists.
    pub(crate) package_lists: PathBuf,
    /// Permission to install packages; `None` until it is determined.
    pub(crate) rights: Option<Rights>,
}

/// Permission to install packages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rights {
    /// This process is root.
    Root,
    /// sudo, without a password.
    Sudo,
    /// Not without a password.
    None,
}

/// Result of running a program.
pub(crate) struct Answer {
    pub(crate) success: bool,
    /// Its standard output, trimmed.
    pub(crate) stdout: String,
    /// Its output on both streams, trimmed.
    pub(crate) text: String,
}

impl Machine {
    /// The machine that this runs on.
    pub(crate) fn this() -> Self {
        Self {
            path: None,
            named_compiler: env::var_os(COMPILER_VARIABLE)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
                // Absolute, because programs also run in other folders.
                .map(|path| match std::path::absolute(&path) {
                    Ok(absolute) if path.components().count() > 1 => absolute,
                    _ => path,
                }),
            debian_compiler: "/usr/bin/rustc".into(),
            package_lists: "/var/lib/apt/lists".into(),
            rights: None,
        }
    }

    /// A program of this machine, without standard input.
    pub(crate) fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        if let Some(path) = &self.path {
            command.env("PATH", path);
        }
        command.stdin(Stdio::null());
        command
    }

    /// Runs a program; `None` if it does not exist.
    pub(crate) fn ask<S: AsRef<OsStr>>(
        &self,
        program: impl AsRef<OsStr>,
        arguments: impl IntoIterator<Item = S>,
    ) -> Option<Answer> {
        answer(self.command(program).args(arguments))
    }

    /// The permission to install packages here.
    pub(crate) fn rights(&self) -> Rights {
        if let Some(rights) = self.rights {
            return rights;
        }
        // The files of a process belong to its effective user.
        if fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0) {
            return Rights::Root;
        }
        match self.ask("sudo", ["-n", "true"]) {
            Some(Answer { success: true, .. }) => Rights::Sudo,
            _ => Rights::None,
        }
    }
}

/// Runs a command and captures its output; `None` if it does not start.
pub(crate) fn answer(command: &mut Command) -> Option<Answer> {
    let output = command.output().ok()?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    Some(Answer {
        success: output.status.success(),
        stdout: text(&output.stdout),
        text: text(&[output.stdout, output.stderr].concat()),
    })
}

/// A temporary folder for a probe.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let folder = env::temp_dir().join(format!(
            "singletrack-{name}-{}-{}",
            std::process::id(),
            NUMBER.fetch_add(1, Ordering::Relaxed)
        ));
        // Must not exist yet, because programs compiled in it are run.
        fs::DirBuilder::new().mode(0o700).create(&folder)?;
        Ok(Self(folder))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Writes a file and returns its path.
    pub(crate) fn file(&self, name: &str, text: &str) -> io::Result<PathBuf> {
        let path = self.0.join(name);
        fs::write(&path, text)?;
        Ok(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Stand-ins for the programs of a machine: shell scripts in a folder of their own.
#[cfg(test)]
pub(crate) mod stand_in {
    use super::*;

    /// A machine that has only the scripts of a test.
    pub(crate) struct Bare {
        pub(crate) folder: PathBuf,
        pub(crate) machine: Machine,
    }

    impl Bare {
        pub(crate) fn new(test: &str) -> Self {
            let folder =
                env::temp_dir().join(format!("singletrack-xtask-{test}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&folder);
            for part in ["bin", "debian/bin", "lists"] {
                fs::create_dir_all(folder.join(part)).unwrap();
            }
            let machine = Machine {
                path: Some(folder.join("bin")),
                named_compiler: None,
                debian_compiler: folder.join("debian/bin/rustc"),
                package_lists: folder.join("lists"),
                rights: Some(Rights::Root),
            };
            Self { folder, machine }
        }

        /// Adds a program to the path, as the body of a POSIX shell script.
        pub(crate) fn program(&self, name: &str, script: &str) -> PathBuf {
            self.write(&Path::new("bin").join(name), script)
        }

        /// Adds a program anywhere in the machine's folder.
        pub(crate) fn write(&self, place: &Path, script: &str) -> PathBuf {
            let path = self.folder.join(place);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            // Written by another process: a file open for writing in this process
            // could be inherited by a program of another test, and could then not
            // be executed.
            let written = Command::new("/bin/sh")
                .args([
                    "-c",
                    "printf '#!/bin/sh\n%s\n' \"$1\" > \"$2\" && chmod 755 \"$2\"",
                    "sh",
                    script,
                ])
                .arg(&path)
                .status()
                .unwrap();
            assert!(written.success());
            path
        }

        /// The calls of [`Self::logged`] programs, one per line.
        pub(crate) fn calls(&self) -> Vec<String> {
            fs::read_to_string(self.folder.join("calls"))
                .unwrap_or_default()
                .lines()
                .map(str::to_owned)
                .collect()
        }

        /// A script line that logs the call.
        pub(crate) fn logged(&self, name: &str) -> String {
            format!(
                "echo \"{name} $*\" >> '{}'",
                self.folder.join("calls").display()
            )
        }
    }

    impl Drop for Bare {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}
