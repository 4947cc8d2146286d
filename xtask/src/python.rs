//! Checks the Python package: installs it into an environment of its own, as its users do, and
//! runs its tests, with the examples and notebooks, and the type checker.

use std::{path::Path, process::Command, thread};

use crate::{
    process::{Failure, check as run, silent},
    readers::environment,
    release::Release,
    target,
    workspace::{cargo, root},
};

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let source = root().join("python");
    let target = target::folder()?;
    run(cargo().current_dir(&source).args(["fmt", "--check"]))?;
    let python = environment(
        &target.join("python-venv"),
        &source.join("requirements.txt"),
        "import gymnasium, maturin, mypy, osqp, pytest, xdist",
    )?;
    let in_source = |arguments: &str| {
        let mut command = Command::new(&python);
        // `-P`: the installed package, not the folder of its sources.
        command
            .arg("-P")
            .args(arguments.split(' '))
            .current_dir(&source);
        command
    };
    // Not in an isolated environment, which would fetch maturin each time. A workspace of its own,
    // with the versions and profiles of this one: what is built is shared. Compiled by clippy,
    // which saves a check of all dependencies.
    let mut install = Command::new(&python);
    install
        .args(["-m", "pip", "install", "--disable-pip-version-check"])
        .args(["--no-build-isolation", "--no-deps", "--force-reinstall"])
        .arg(&source)
        .env("CARGO_TARGET_DIR", &target)
        .env("RUSTC_WORKSPACE_WRAPPER", "clippy-driver")
        .env("MATURIN_PEP517_ARGS", "--locked -- -Dwarnings")
        .env("PATH", path_with(&python)?);
    // The types are those of the sources: they need no build.
    thread::scope(|scope| {
        let types = scope.spawn(|| run(&mut in_source("-m mypy singletrack examples tests")));
        silent(&mut install)?;
        types
            .join()
            .unwrap_or_else(|_| Err(Failure::new("the check of the types panicked".to_owned())))
    })?;
    // Two at a time: those in real time wait more than they calculate.
    let mut tests = in_source("-m pytest --quiet -n 2 -p no:cacheprovider");
    tests
        .env("SINGLETRACKD", release.path("singletrackd")?)
        .env("SINGLETRACK_SIM", release.path("singletrack-sim")?)
        // Not an image that is older, or another's.
        .env_remove("SINGLETRACK_UNO");
    if release.uno {
        tests.env("SINGLETRACK_UNO", release.image()?.folder);
    }
    run(&mut tests)
}

/// The search path with the programs of the environment, of which maturin is one.
fn path_with(python: &Path) -> Result<std::ffi::OsString, Failure> {
    let programs = python.parent().map(Path::to_path_buf);
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::join_paths(programs.into_iter().chain(std::env::split_paths(&path)))
        .map_err(|error| Failure::new(error.to_string()))
}

#[cfg(test)]
mod tests {
    use std::{collections::HashSet, fs};

    use super::root;

    /// Name and version of every locked package.
    fn locked(file: &str) -> HashSet<(String, String)> {
        let text = fs::read_to_string(root().join(file)).unwrap();
        let value = |line: &str, key: &str| {
            let value = line.strip_prefix(key)?.strip_prefix(" = ")?;
            Some(value.trim_matches('"').to_owned())
        };
        let lines: Vec<&str> = text.lines().collect();
        lines
            .windows(2)
            .filter_map(|pair| Some((value(pair[0], "name")?, value(pair[1], "version")?)))
            .collect()
    }

    /// Versions of the same series replace each other: 1.x, 0.2.x.
    fn series((name, version): &(String, String)) -> (String, String) {
        let parts: Vec<&str> = version.split('.').collect();
        let major = usize::from(parts[0] == "0");
        (name.clone(), parts[..=major].join("."))
    }

    #[test]
    fn the_package_has_the_versions_of_the_workspace() {
        let workspace = locked("Cargo.lock");
        let known: HashSet<_> = workspace.iter().map(series).collect();
        let package = locked("python/Cargo.lock");
        assert!(package.len() > 100, "the lock file was not read");
        for package in package {
            let (name, version) = &package;
            assert!(
                !known.contains(&series(&package)) || workspace.contains(&package),
                "{name} {version}: copy Cargo.lock to python/ and run `cargo update --workspace` there"
            );
        }
    }
}
