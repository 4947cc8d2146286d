//! Checks with Python: the package, the readers of records in other labs' tools, and the node of ROS 2.

use std::{
    env,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    notes,
    prerequisites::{self, AARCH64},
    process::{NOT_VALID, Result, check, failure, program, silent},
    programs::Packages,
    workspace::{copy, emptied, put, root, script, target, write},
};

/// The Python of the environment `name` in the target folder: with the packages of
/// `source/requirements.txt`, and with messages of ROS if there is a `source/messages.py`. It is made again
/// unless it can import these modules.
fn environment(name: &str, source: &Path, modules: &str) -> Result<PathBuf> {
    let folder = target()?.join(name);
    let mut environment = script("xtask/src/environment.sh");
    check(environment.args([&folder, source]).arg(modules))?;
    Ok(folder.join("bin/python"))
}

/// The environment of the package's build and of its tests.
fn package_environment() -> Result<PathBuf> {
    let modules = "fmpy, gymnasium, matplotlib, maturin, mypy, osqp, pytest, xdist";
    environment("python-venv", &root().join("python"), modules)
}

/// maturin's options for wheels that need the C library of Ubuntu 22.04: it refuses a module that needs
/// more.
const WHEEL: &str = "--quiet --compatibility manylinux_2_35 --auditwheel check --out";

/// The wheels' native module, as programs are named in `programs.rs`.
pub(crate) const MODULE: (&str, &str) = ("_native", "singletrack-python");

/// Makes the wheels for x86-64 and ARM64 in a folder, and drives with the one for this machine.
pub(crate) fn make_wheels(folder: &Path) -> Result {
    prerequisites::ensure(&["arm64"])?;
    let source = root().join("python");
    // maturin packs the file with the licences.
    let licences = notes::licences(&[MODULE], &notes::TARGETS)?;
    write(&source.join("NOTICES"), licences)?;
    let python = package_environment()?;
    let maturin = python.with_file_name("maturin");
    let mut native = program(&maturin, "build --locked --profile release --target-dir");
    native.arg(target()?);
    let mut foreign = Command::new(&maturin);
    AARCH64.maturin_build(&mut foreign)?;
    // The search path with the programs of the environment, of which maturin is one.
    let programs = python.parent().map(Path::to_path_buf).into_iter();
    let path = env::var_os("PATH").unwrap_or_default();
    let path = env::join_paths(programs.chain(env::split_paths(&path)))
        .map_err(|error| failure!("PATH: {error}"))?;
    for mut maturin in [native, foreign] {
        maturin.args(WHEEL.split(' ')).arg(folder);
        check(maturin.current_dir(&source).env("PATH", &path))?;
    }
    let installed = emptied("wheel")?;
    let pip = "-m pip install --no-compile --disable-pip-version-check --no-deps --no-index";
    let mut install = program(&python, pip);
    install.arg("--find-links").arg(folder);
    install.arg("--target").arg(&installed);
    silent(install.arg(concat!("singletrack==", env!("CARGO_PKG_VERSION"))))?;
    let mut simulate = Command::new(&python);
    let text = "import singletrack; singletrack.Simulator().step(100)";
    check(simulate.args(["-c", text]).env("PYTHONPATH", installed))
}

/// Runs the tests of the package, with the examples and notebooks, and the type checker. The package
/// has the native module of the tested build, and its metadata by its installer; `cargo release`
/// installs a wheel.
pub(crate) fn check_package(packages: &Packages) -> Result {
    let source = root().join("python");
    let python = package_environment()?;
    let folder = emptied("python-package")?;
    copy(&source.join("singletrack"), &folder.join("singletrack"))?;
    let module = packages.build("--lib", "lib_native.so")?;
    put(&module, &folder.join("singletrack/_native.abi3.so"))?;
    let maturin = python.with_file_name("maturin");
    let mut metadata = program(maturin, "pep517 write-dist-info --metadata-directory");
    silent(metadata.arg(&folder).current_dir(&source))?;
    let in_source = |arguments: &str| {
        let mut command = program(&python, arguments);
        command.current_dir(&source).env("PYTHONPATH", &folder);
        command
    };
    // `-P`: the package, not the folder of its sources. Two tests at a time: those in real time wait more
    // than they calculate.
    let mut tests = in_source("-P -m pytest --quiet -n 2 -p no:cacheprovider");
    tests.env("SINGLETRACKD", packages.path("singletrackd")?);
    tests.env("SINGLETRACK_SIM", packages.path("singletrack-sim")?);
    tests.env("SINGLETRACK_FMU", packages.path("singletrack-fmu")?);
    // The types are those of the sources: they need no build.
    check(&mut in_source("-P -m mypy singletrack examples tests"))?;
    packages.check_with_image(&mut tests)
}

/// Two readers from the Python package index open a record and compare its contents, and clients
/// of other cameras read the simulated ones.
pub(crate) fn check_readers(packages: &Packages) -> Result {
    let source = root().join("tests/readers");
    let modules = "mcap_ros2, motioncapture, qtm_rt, rosbags";
    let python = environment("readers-venv", &source, modules)?;
    let singletrack = packages.path("singletrack")?;
    let record = emptied("readers")?.join("circle.mcap");
    let mut simulate = program(&singletrack, "simulate --record");
    simulate.arg(&record).arg(source.join("circle.toml"));
    check(simulate.stdout(Stdio::null()))?;
    let script = |name: &str| {
        let mut script = Command::new(&python);
        script.arg(source.join(name));
        script
    };
    check(script("check.py").args([&singletrack, &record]))?;
    check(script("cameras.py").arg(packages.path("singletrack-sim")?))
}

/// Checks the node of ROS 2 with rclpy, in a network of its own: the daemon drives the simulated car in
/// real time.
pub(crate) fn check_node(packages: &Packages) -> Result {
    let source = root().join("tests/ros");
    let modules = "rclpy, ackermann_msgs.msg, tf2_msgs.msg";
    let python = environment("ros-venv", &source, modules)?;
    let mut drive = script("xtask/src/isolated.sh");
    drive.arg(python).arg(source.join("check.py"));
    drive.args([packages.path("")?, target()?.join("ros")]);
    // The variables of an installed ROS do not count.
    let kept = env::vars_os().filter(|(name, _)| name == "PATH" || name == "HOME");
    drive.env_clear().envs(kept);
    let mut attempt = || emptied("ros").and_then(|_| check(&mut drive));
    // One that was not valid is tried again.
    for _ in 0..2 {
        match attempt() {
            Err(failure) if failure.status == NOT_VALID => {
                println!("Again: this machine was too busy for real time");
            }
            done => return done,
        }
    }
    attempt()
}
