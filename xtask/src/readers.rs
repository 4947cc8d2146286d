//! Records are for the tools that labs already use: two readers from the package index open
//! one, and find in it what we say it holds.

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    debian,
    step::{Failure, cargo, check as run, root},
    target,
};

/// Debian's, where the one in the path cannot make an environment.
const DEBIANS_PYTHON: &str = "/usr/bin/python3";

pub(crate) fn check() -> Result<(), Failure> {
    let target = target::folder()?;
    let source = root().join("tests/readers");
    let python = environment(
        &target.join("readers-venv"),
        &source.join("requirements.txt"),
    )?;
    run(cargo().args(["build", "--quiet", "--release", "--bin", "singletrack"]))?;
    let singletrack = target.join("release/singletrack");
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

/// An environment with the packages required; its Python.
fn environment(folder: &Path, requirements: &Path) -> Result<PathBuf, Failure> {
    let wanted = fs::read(requirements)
        .map_err(|error| Failure::new(format!("{}: {error}", requirements.display())))?;
    let python = folder.join("bin/python");
    // Left by the last one to get this far.
    let installed = folder.join("installed.txt");
    if fs::read(&installed).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    let maker = maker()?;
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
    fs::write(&installed, wanted)
        .map_err(|error| Failure::new(format!("{}: {error}", installed.display())))?;
    Ok(python)
}

/// A Python that can make environments. Debian keeps what that takes in a package
/// of its own.
fn maker() -> Result<&'static str, Failure> {
    if makes_environments("python3") {
        return Ok("python3");
    }
    debian::ensure(&[debian::PYTHON])?;
    if makes_environments(DEBIANS_PYTHON) {
        return Ok(DEBIANS_PYTHON);
    }
    Err(Failure::new(format!(
        "{DEBIANS_PYTHON} -c 'import venv, ensurepip' fails, with python3-venv installed"
    )))
}

fn makes_environments(python: &str) -> bool {
    let status = Command::new(python)
        .args(["-c", "import venv, ensurepip"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    status.is_ok_and(|status| status.success())
}

/// Runs a command whose chatter is of interest only if it fails.
fn silent(command: &mut Command) -> Result<(), Failure> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| Failure::new(format!("{name} does not start: {error}")))?;
    if output.status.success() {
        return Ok(());
    }
    let said = [output.stdout, output.stderr].concat();
    Err(Failure::new(format!(
        "{name}: {}\n{}",
        output.status,
        String::from_utf8_lossy(&said)
    )))
}

/// A folder with nothing in it.
fn empty(folder: &Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    fs::create_dir_all(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_command_says_is_told_if_it_fails() {
        let said = |script: &str| silent(Command::new("/bin/sh").args(["-c", script]));
        assert!(said("echo much").is_ok());
        let failure = said("echo this is why; exit 3").unwrap_err().to_string();
        assert!(failure.contains("exit status: 3"), "{failure}");
        assert!(failure.ends_with("this is why\n"), "{failure}");
    }

    #[test]
    fn what_is_no_python_makes_no_environment() {
        assert!(!makes_environments("/bin/false"));
        assert!(!makes_environments("no-such-python"));
    }
}
