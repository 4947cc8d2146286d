//! Checks with Python: the package, the readers of records in other labs' tools, and the node of ROS 2.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    notes, prerequisites,
    process::{At as _, Failure, Result, check, failure, silent},
    programs::Packages,
    target,
    toolchain::AARCH64,
    workspace::{root, script},
};

/// Packages of messages of ROS that are on no package index, and those that they use.
const MESSAGES: [(&str, &str); 2] = [
    ("ackermann_msgs", "std_msgs"),
    ("tf2_msgs", "geometry_msgs"),
];

/// Creates the environment `name` in the target folder with the packages of `source/requirements.txt`,
/// unless it is there with these, and its Python can import these modules; returns its Python. If there
/// is a `source/messages.py`, that builds the packages of messages of ROS.
fn environment(name: &str, source: &Path, modules: &str) -> Result<PathBuf> {
    let folder = target::folder()?.join(name);
    let requirements = source.join("requirements.txt");
    let builder = source.join("messages.py");
    let is_ros = builder.is_file();
    let mut required = fs::read(&requirements).at(&requirements)?;
    if is_ros {
        required.extend(fs::read(&builder).at(&builder)?);
    }
    let python = folder.join("bin/python");
    // Written after the last successful installation.
    let installed = folder.join("installed.txt");
    // Its Python may have been removed or replaced.
    let works = || silent(Command::new(&python).args(["-c", &format!("import {modules}")])).is_ok();
    if fs::read(&installed).is_ok_and(|installed| installed == required) && works() {
        return Ok(python);
    }
    let mut maker = Command::new(prerequisites::find("find_python")?);
    maker.args(["-m", "venv", "--clear"]);
    // The wheels of ROS write into the environment and start its Python again.
    maker.args(is_ros.then_some("--copies"));
    silent(maker.arg(&folder))?;
    println!("Installing Python packages into {}", folder.display());
    if is_ros {
        // Their builds need it.
        silent(pip(&python).arg("wheel==0.48.0"))?;
    }
    silent(pip(&python).arg("-r").arg(&requirements))?;
    for (package, used) in MESSAGES.into_iter().filter(|_| is_ros) {
        let mut make = Command::new(&python);
        make.arg(&builder).arg(source.join(package));
        silent(make.arg(folder.join("build")).arg(used))?;
    }
    fs::write(&installed, required).at(&installed)?;
    Ok(python)
}

/// pip, to install what its further arguments say.
fn pip(python: &Path) -> Command {
    let mut pip = Command::new(python);
    // What is imported is compiled then.
    let quickly = ["--no-compile", "--disable-pip-version-check"];
    pip.args(["-m", "pip", "install"]).args(quickly);
    pip
}

/// The environment of the package's build and of its tests.
fn package_environment() -> Result<PathBuf> {
    let modules = "fmpy, gymnasium, matplotlib, maturin, mypy, osqp, pytest, xdist";
    environment("python-venv", &root().join("python"), modules)
}

/// The C library that wheels need: that of Ubuntu 22.04. maturin refuses a module that needs more.
const COMPATIBILITY: &str = "manylinux_2_35";

/// The wheels' native module, as programs are named in `programs.rs`.
pub(crate) const MODULE: (&str, &str) = ("_native", "singletrack-python");

/// Makes the wheels for x86-64 and ARM64 in a folder, and drives with the one for this machine.
pub(crate) fn make_wheels(folder: &Path) -> Result {
    prerequisites::ensure(&["arm64"])?;
    let source = root().join("python");
    let target = target::folder()?;
    // maturin packs the file with the licences.
    let notices = source.join("NOTICES");
    let text = notes::licences(&[MODULE], &notes::TARGETS)?;
    fs::write(&notices, text).at(&notices)?;
    let python = package_environment()?;
    let maturin = || Command::new(python.with_file_name("maturin"));
    let mut native = maturin();
    native.args(["build", "--locked", "--profile", "release", "--target-dir"]);
    native.arg(&target);
    let mut foreign = maturin();
    AARCH64.maturin_build(&mut foreign)?;
    for mut maturin in [native, foreign] {
        maturin
            .args(["--quiet", "--compatibility", COMPATIBILITY])
            .args(["--auditwheel", "check", "--out"])
            .arg(folder)
            .current_dir(&source)
            .env("PATH", path_with(&python)?);
        check(&mut maturin)?;
    }
    let installed = target::emptied("wheel")?;
    let mut install = pip(&python);
    install.args(["--no-deps", "--no-index", "--find-links"]);
    install.arg(folder).arg("--target").arg(&installed);
    silent(install.arg(concat!("singletrack==", env!("CARGO_PKG_VERSION"))))?;
    let mut simulate = Command::new(&python);
    let program = "import singletrack; singletrack.Simulator().step(100)";
    check(simulate.args(["-c", program]).env("PYTHONPATH", installed))
}

/// Runs the tests of the package, with the examples and notebooks, and the type checker. The package
/// has the native module of the tested build, and its metadata by its installer; `cargo release`
/// installs a wheel.
pub(crate) fn check_package(packages: &Packages) -> Result {
    let source = root().join("python");
    let python = package_environment()?;
    let folder = target::emptied("python-package")?;
    target::copy(&source.join("singletrack"), &folder.join("singletrack"))?;
    let module = packages.library("lib_native.so")?;
    target::put(&module, &folder.join("singletrack/_native.abi3.so"))?;
    let mut metadata = Command::new(python.with_file_name("maturin"));
    metadata.args(["pep517", "write-dist-info", "--metadata-directory"]);
    silent(metadata.arg(&folder).current_dir(&source))?;
    let in_source = |arguments: &str| {
        let mut command = Command::new(&python);
        // `-P`: the package, not the folder of its sources.
        command.arg("-P").args(arguments.split(' '));
        command.current_dir(&source).env("PYTHONPATH", &folder);
        command
    };
    // Two at a time: those in real time wait more than they calculate.
    let mut tests = in_source("-m pytest --quiet -n 2 -p no:cacheprovider");
    tests
        .env("SINGLETRACKD", packages.path("singletrackd")?)
        .env("SINGLETRACK_SIM", packages.path("singletrack-sim")?)
        .env("SINGLETRACK_FMU", packages.path("singletrack-fmu")?);
    // The types are those of the sources: they need no build.
    check(&mut in_source("-m mypy singletrack examples tests"))?;
    packages.check_with_image(&mut tests)
}

/// The search path with the programs of the environment, of which maturin is one.
fn path_with(python: &Path) -> Result<std::ffi::OsString> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let programs = python.parent().map(Path::to_path_buf).into_iter();
    let path = programs.chain(std::env::split_paths(&path));
    std::env::join_paths(path).map_err(|error| failure!("PATH: {error}"))
}

/// Two readers from the Python package index open a record and compare its contents, and clients
/// of other cameras read the simulated ones.
pub(crate) fn check_readers(packages: &Packages) -> Result {
    let source = root().join("tests/readers");
    let modules = "mcap_ros2, motioncapture, qtm_rt, rosbags";
    let python = environment("readers-venv", &source, modules)?;
    let singletrack = packages.path("singletrack")?;
    let folder = target::emptied("readers")?;
    let record = folder.join("circle.mcap");
    let mut simulate = Command::new(&singletrack);
    simulate.arg("simulate").arg(source.join("circle.toml"));
    simulate.arg("--record").arg(&record).stdout(Stdio::null());
    check(&mut simulate)?;
    let script = |name: &str| {
        let mut script = Command::new(&python);
        script.arg(source.join(name));
        script
    };
    check(script("check.py").args([&singletrack, &record]))?;
    check(script("cameras.py").arg(packages.path("singletrack-sim")?))
}

/// A check of the node that was not valid is tried again.
const TRIES: u32 = 3;

/// Checks the node of ROS 2 with rclpy, in a network of its own: the daemon drives the simulated car in
/// real time.
pub(crate) fn check_node(packages: &Packages) -> Result {
    let source = root().join("tests/ros");
    let modules = "rclpy, ackermann_msgs.msg, tf2_msgs.msg";
    let python = environment("ros-venv", &source, modules)?;
    let mut drive = script("xtask/src/isolated.sh");
    drive
        .arg(python)
        .arg(source.join("check.py"))
        .args([&packages.path("")?, &target::folder()?.join("ros")])
        // The variables of an installed ROS do not count.
        .env_clear()
        .envs(std::env::vars_os().filter(|(name, _)| name == "PATH" || name == "HOME"));
    let mut tries = 0;
    loop {
        target::emptied("ros")?;
        tries += 1;
        match check(&mut drive) {
            Err(Failure::NotValid(_)) if tries < TRIES => {
                println!("Again: this machine was too busy for real time");
            }
            done => return done,
        }
    }
}
