//! Checks `singletrack-ros` with rclpy from the Python package index, in a network namespace of
//! its own: the daemon drives the simulated car in real time.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    prerequisites,
    process::{Failure, check as run, silent},
    readers::empty,
    release::Release,
    target,
    workspace::root,
};

/// `unshare` with these arguments needs no rights.
pub(crate) const NAMESPACE: [&str; 2] = ["--map-root-user", "--net"];

/// A check that failed while the machine was late ends with this status, and is tried again.
const REPEAT: i32 = 75;
const TRIES: usize = 3;

/// Discovery uses multicast, which loopback does not have by default.
const LOOPBACK: &str = "ip link set lo up && ip link set lo multicast on && \
                        ip route add 224.0.0.0/4 dev lo && exec \"$@\"";

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let target = target::folder()?;
    let source = root().join("tests/ros");
    let python = environment(&target.join("ros-venv"), &source)?;
    release.build()?;
    let folder = target.join("ros");
    let mut check = Command::new("unshare");
    check
        .args(NAMESPACE)
        .args(["sh", "-c", LOOPBACK, "sh"])
        .arg(python)
        .arg(source.join("check.py"))
        .args([&target.join("release"), &folder])
        .arg("--configuration")
        .arg(root().join("host/daemon/singletrackd.example.toml"))
        // The variables of an installed ROS do not count.
        .env_clear()
        .envs(std::env::vars_os().filter(|(name, _)| name == "PATH" || name == "HOME"));
    for _ in 1..TRIES {
        empty(&folder).map_err(|error| Failure::new(format!("{}: {error}", folder.display())))?;
        let status = check
            .status()
            .map_err(|error| Failure::new(format!("unshare does not start: {error}")))?;
        if status.success() {
            return Ok(());
        }
        if status.code() != Some(REPEAT) {
            return Err(Failure::new(format!("the check ended with {status}")));
        }
        println!("Again: this machine was too busy for real time");
    }
    empty(&folder).map_err(|error| Failure::new(format!("{}: {error}", folder.display())))?;
    run(&mut check)
}

/// Packages of messages that are on no package index, and those that they use.
const MESSAGES: [(&str, &str); 2] = [
    ("ackermann_msgs", "std_msgs"),
    ("tf2_msgs", "geometry_msgs"),
];

/// Creates an environment with rclpy and the [`MESSAGES`]; returns its Python.
fn environment(folder: &Path, source: &Path) -> Result<PathBuf, Failure> {
    let requirements = source.join("requirements.txt");
    let builder = source.join("messages.py");
    let read = |path: &Path| {
        fs::read(path).map_err(|error| Failure::new(format!("{}: {error}", path.display())))
    };
    let required = [read(&requirements)?, read(&builder)?].concat();
    let python = folder.join("bin/python");
    // Written after the last successful installation.
    let installed = folder.join("installed.txt");
    let works = || {
        silent(Command::new(&python).args(["-c", "import rclpy, ackermann_msgs.msg, tf2_msgs.msg"]))
    };
    if fs::read(&installed).is_ok_and(|installed| installed == required) && works().is_ok() {
        return Ok(python);
    }
    let maker = prerequisites::python()?;
    // The wheels of ROS write into the environment and start its Python again.
    silent(
        Command::new(maker)
            .args(["-m", "venv", "--copies", "--clear"])
            .arg(folder),
    )?;
    println!("Installing ROS 2 for Python into {}", folder.display());
    let pip = || {
        let mut pip = Command::new(&python);
        pip.args(["-m", "pip", "install", "--disable-pip-version-check"]);
        pip
    };
    silent(pip().arg("wheel==0.48.0"))?;
    silent(pip().arg("-r").arg(&requirements))?;
    for (package, used) in MESSAGES {
        silent(
            Command::new(&python)
                .arg(&builder)
                .arg(source.join(package))
                .args([&folder.join("build"), Path::new(used)]),
        )?;
    }
    fs::write(&installed, required)
        .map_err(|error| Failure::new(format!("{}: {error}", installed.display())))?;
    Ok(python)
}
