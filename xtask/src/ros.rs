//! Checks `singletrack-ros` with rclpy from the Python package index, in a network namespace of
//! its own: the daemon drives the simulated car in real time.

use std::{path::Path, process::Command};

use crate::{
    process::{Failure, check as run, failure, silent},
    programs::Packages,
    python::{Environment, empty},
    target,
    workspace::root,
};

/// `unshare` with these arguments needs no rights.
const NAMESPACE: [&str; 2] = ["--map-root-user", "--net"];

/// A check that failed while the machine was late ends with this status, and is tried again.
const REPEAT: i32 = 75;
const TRIES: usize = 3;

/// Discovery uses multicast, which loopback does not have by default.
const LOOPBACK: &str = "ip link set lo up && ip link set lo multicast on && \
                        ip route add 224.0.0.0/4 dev lo && exec \"$@\"";

/// Packages of messages that are on no package index, and those that they use.
const MESSAGES: [(&str, &str); 2] = [
    ("ackermann_msgs", "std_msgs"),
    ("tf2_msgs", "geometry_msgs"),
];

pub(crate) fn check(packages: &Packages) -> Result<(), Failure> {
    let source = root().join("tests/ros");
    let builder = source.join("messages.py");
    let build = target::folder()?.join("ros-venv/build");
    let python = Environment {
        name: "ros-venv",
        source: source.clone(),
        // The wheels of ROS write into the environment and start its Python again.
        options: &["--copies"],
        first: &["wheel==0.48.0"],
        probe: "import rclpy, ackermann_msgs.msg, tf2_msgs.msg",
        also: &["messages.py"],
    }
    .ensure(&|python| {
        MESSAGES.into_iter().try_for_each(|(package, used)| {
            let mut make = Command::new(python);
            make.arg(&builder).arg(source.join(package));
            silent(make.args([&build, Path::new(used)]))
        })
    })?;
    let programs = packages.path("")?;
    let folder = target::folder()?.join("ros");
    let mut check = Command::new("unshare");
    check
        .args(NAMESPACE)
        .args(["sh", "-c", LOOPBACK, "sh"])
        .arg(python)
        .arg(source.join("check.py"))
        .args([&programs, &folder])
        .arg("--configuration")
        .arg(root().join("host/daemon/singletrackd.example.toml"))
        // The variables of an installed ROS do not count.
        .env_clear()
        .envs(std::env::vars_os().filter(|(name, _)| name == "PATH" || name == "HOME"));
    for _ in 1..TRIES {
        empty(&folder)?;
        let status = check
            .status()
            .map_err(|error| failure!("unshare does not start: {error}"))?;
        if status.success() {
            return Ok(());
        }
        if status.code() != Some(REPEAT) {
            return Err(failure!("the check ended with {status}"));
        }
        println!("Again: this machine was too busy for real time");
    }
    empty(&folder)?;
    run(&mut check)
}
