//! Checks records with the readers of other labs' tools: two readers from the
//! Python package index open one and compare its contents.

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    prerequisites,
    process::{Failure, check as run, silent},
    release::Release,
    target,
    workspace::root,
};

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let target = target::folder()?;
    let source = root().join("tests/readers");
    let python = environment(
        &target.join("readers-venv"),
        &source.join("requirements.txt"),
        "import mcap_ros2, rosbags",
    )?;
    let singletrack = release.path("singletrack")?;
    let folder = target.join("readers");
    empty(&folder).map_err(|error| Failure::new(format!("{}: {error}", folder.display())))?;
    let record = folder.join("circle.mcap");
    run(Command::new(&singletrack)
        .arg("simulate")
        .arg(source.join("circle.toml"))
        .arg("--record")
        .arg(&record)
        .stdout(Stdio::null()))?;
    run(Command::new(python)
        .arg(source.join("check.py"))
        .args([&singletrack, &record]))
}

/// Creates an environment with the required packages; returns its Python. `probe` is a program
/// that succeeds if they work.
pub(crate) fn environment(
    folder: &Path,
    requirements: &Path,
    probe: &str,
) -> Result<PathBuf, Failure> {
    let required = fs::read(requirements)
        .map_err(|error| Failure::new(format!("{}: {error}", requirements.display())))?;
    let python = folder.join("bin/python");
    // Written after the last successful installation.
    let installed = folder.join("installed.txt");
    // Its Python may have been removed or replaced.
    let works = || silent(Command::new(&python).args(["-c", probe])).is_ok();
    if fs::read(&installed).is_ok_and(|installed| installed == required) && works() {
        return Ok(python);
    }
    let maker = prerequisites::python()?;
    silent(
        Command::new(maker)
            .args(["-m", "venv", "--clear"])
            .arg(folder),
    )?;
    println!("Installing Python packages into {}", folder.display());
    silent(
        Command::new(&python)
            .args(["-m", "pip", "install", "--disable-pip-version-check", "-r"])
            .arg(requirements),
    )?;
    fs::write(&installed, required)
        .map_err(|error| Failure::new(format!("{}: {error}", installed.display())))?;
    Ok(python)
}

/// Creates or empties a folder.
pub(crate) fn empty(folder: &Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    fs::create_dir_all(folder)
}
