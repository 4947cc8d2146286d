//! Each package must build alone. In the workspace's build a package has the
//! features that any other asks for, which hides the ones it forgot. (The suites for
//! hardware in the loop and for faults are built alone to be run.)

use crate::step::{Failure, cargo, check};

const PACKAGES: [&str; 12] = [
    "singletrack-protocol",
    "singletrack-board",
    "singletrack-control",
    "singletrack-analysis",
    "singletrack-mocap",
    "singletrack-link",
    "singletrack-record",
    "singletrackd",
    "singletrack-simavr",
    "singletrack-sim",
    "singletrack",
    "singletrack-fuzz",
];

pub(crate) fn check_all() -> Result<(), Failure> {
    PACKAGES
        .into_iter()
        .try_for_each(|package| check(cargo().args(["check", "--quiet", "--package", package])))
}
