//! Lays out the files that `packaging/debian/install` names, and packs them with debhelper.

use std::{
    fs, io,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::Command,
};

use super::{Architecture, PROGRAMS};
use crate::{
    image::Image,
    libraries,
    process::{Failure, check, output, silent},
    target,
    workspace::root,
};

/// Files of `packaging/` under the names that debhelper looks for in `debian/`.
const FOR_DEBHELPER: [(&str, &str); 3] = [
    ("99-singletrack.rules", "singletrack.udev"),
    ("sysusers.d/singletrack.conf", "singletrack.sysusers"),
    ("singletrackd.service", "singletrack.singletrackd.service"),
];

/// How much time is spent on a small package.
#[derive(Clone, Copy)]
pub(super) enum Compression {
    /// For a package that is to be installed.
    Small,
    /// For a package that is only checked: a third larger, in an eighth of the time.
    Fast,
}

impl Compression {
    fn level(self) -> &'static str {
        match self {
            Self::Small => "6",
            Self::Fast => "1",
        }
    }
}

/// Makes the package in `target/debian/` and returns its path.
pub(super) fn pack(
    architecture: Architecture,
    programs: &Path,
    image: Option<&Image>,
    compression: Compression,
) -> Result<PathBuf, Failure> {
    let name = architecture.name();
    let stage = stage(architecture)?;
    let packages = target::folder()?.join("debian");
    let unwritten = |error| Failure::new(format!("can't write to {}: {error}", stage.display()));
    lay_out(&stage, programs).map_err(unwritten)?;
    remove_packages(&packages, name).map_err(unwritten)?;
    let singletrack = programs.join("singletrack");
    check(
        architecture
            .run(&singletrack)
            .args(["install-files", "--out"])
            .arg(&stage),
    )?;
    if let Some(image) = image {
        let hex = stage.join("share/singletrack-uno.hex");
        check(
            Command::new("avr-objcopy")
                .args(["-O", "ihex", "-R", ".eeprom"])
                .args([&image.elf, &hex]),
        )?;
    }
    let crates = PROGRAMS.map(|(_, package)| package);
    let notices = libraries::notices(&crates, architecture.triple())?;
    finish(&stage, &notices).map_err(unwritten)?;
    silent(
        Command::new("dpkg-architecture")
            .current_dir(&stage)
            .env("DEB_RULES_REQUIRES_ROOT", "no")
            // There is nothing to build and to test.
            .env("DEB_BUILD_OPTIONS", "nocheck")
            .env("COMPRESSION", compression.level())
            .args(["--host-arch", name, "--force"])
            .args(["--command", "debian/rules", "binary"]),
    )?;
    let version = output(
        Command::new("dpkg-parsechangelog")
            .current_dir(&stage)
            .args(["--show-field", "Version"]),
    )?;
    let version = String::from_utf8_lossy(&version);
    Ok(packages.join(format!("singletrack_{}_{name}.deb", version.trim())))
}

/// The folder in which a package is laid out. debian/rules puts the package in `../../debian`,
/// which holds nothing but packages.
pub(super) fn stage(architecture: Architecture) -> Result<PathBuf, Failure> {
    let folder = target::folder()?.join("debian-stage");
    Ok(folder.join(architecture.name()))
}

/// Removes the packages of other versions, which an installation by a pattern would take too.
fn remove_packages(folder: &Path, architecture: &str) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        if name
            .to_string_lossy()
            .ends_with(&format!("_{architecture}.deb"))
        {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn lay_out(stage: &Path, programs: &Path) -> io::Result<()> {
    let packaging = root().join("packaging");
    if stage.exists() {
        fs::remove_dir_all(stage)?;
    }
    for folder in ["debian", "programs", "share/scenarios"] {
        fs::create_dir_all(stage.join(folder))?;
    }
    symlink(&packaging, stage.join("packaging"))?;
    copy_files(&packaging.join("debian"), &stage.join("debian"), |_| true)?;
    for (from, to) in FOR_DEBHELPER {
        fs::copy(packaging.join(from), stage.join("debian").join(to))?;
    }
    for (program, _) in PROGRAMS {
        fs::copy(programs.join(program), stage.join("programs").join(program))?;
    }
    let example = "singletrackd.example.toml";
    fs::copy(
        root().join("host/daemon").join(example),
        stage.join("share").join(example),
    )?;
    copy_files(
        &root().join("tools/scenarios"),
        &stage.join("share/scenarios"),
        |name| name.ends_with(".toml"),
    )
}

/// What needs the files that programs have written.
fn finish(stage: &Path, notices: &str) -> io::Result<()> {
    // bash looks for the completions of a command under its name alone.
    for entry in fs::read_dir(stage.join("bash"))? {
        let path = entry?.path();
        fs::rename(&path, path.with_extension(""))?;
    }
    fs::write(stage.join("libraries.txt"), notices)
}

/// Copies the files of a folder, without its folders.
fn copy_files(from: &Path, to: &Path, chosen: impl Fn(&str) -> bool) -> io::Result<()> {
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let name = entry.file_name();
        if entry.path().is_file() && chosen(&name.to_string_lossy()) {
            fs::copy(entry.path(), to.join(name))?;
        }
    }
    Ok(())
}
