//! Checks the Python package: installs it into an environment of its own, as its users do, and
//! runs its tests, the type checker and the examples.

use std::{path::Path, process::Command};

use crate::{
    process::{Failure, check as run, silent},
    readers::environment,
    release::Release,
    target,
    workspace::{cargo, root},
};

/// The examples, in short versions.
const EXAMPLES: [&[&str]; 4] = [
    &["p_control.py"],
    &["mpc.py"],
    &["throughput.py", "--short"],
    &["train.py", "--short"],
];

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let source = root().join("python");
    let target = target::folder()?;
    // The package's own workspace; its build is kept beside the others.
    let build = target.join("python");
    let cargo_in_source = || {
        let mut command = cargo();
        command.current_dir(&source).env("CARGO_TARGET_DIR", &build);
        command
    };
    run(cargo_in_source().args(["fmt", "--check"]))?;
    run(cargo_in_source().args(["clippy", "--release", "--locked", "--", "-D", "warnings"]))?;
    let python = environment(
        &target.join("python-venv"),
        &source.join("requirements.txt"),
        "import gymnasium, maturin, mypy, osqp, pytest",
    )?;
    // Not in an isolated environment, which would fetch maturin each time.
    silent(
        Command::new(&python)
            .args(["-m", "pip", "install", "--disable-pip-version-check"])
            .args(["--no-build-isolation", "--no-deps", "--force-reinstall"])
            .arg(&source)
            .env("CARGO_TARGET_DIR", &build)
            .env("PATH", path_with(&python)?),
    )?;
    let in_source = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        // `-P`: the installed package, not the folder of its sources.
        command.arg("-P").args(arguments).current_dir(&source);
        command
    };
    run(&mut in_source(&["-m", "mypy", "singletrack", "examples"]))?;
    run(
        in_source(&["-m", "pytest", "--quiet", "-p", "no:cacheprovider"])
            .env("SINGLETRACKD", release.path("singletrackd")?)
            .env("SINGLETRACK_SIM", release.path("singletrack-sim")?),
    )?;
    let folder = target.join("python-examples");
    std::fs::create_dir_all(&folder)
        .map_err(|error| Failure::new(format!("{}: {error}", folder.display())))?;
    for example in EXAMPLES {
        let [name, arguments @ ..] = example else {
            continue;
        };
        run(Command::new(&python)
            .arg("-P")
            .arg(source.join("examples").join(name))
            .args(arguments)
            .current_dir(&folder))?;
    }
    Ok(())
}

/// The search path with the programs of the environment, of which maturin is one.
fn path_with(python: &Path) -> Result<std::ffi::OsString, Failure> {
    let programs = python.parent().map(Path::to_path_buf);
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::join_paths(programs.into_iter().chain(std::env::split_paths(&path)))
        .map_err(|error| Failure::new(error.to_string()))
}
