//! Checks that each pure package builds alone. In the workspace's build, a package
//! has the features requested by all others, which hides missing ones. The host's
//! packages are not checked: it takes minutes, and missing features of those that
//! users build alone (`cargo demo`, `cargo faults`) are errors at once.

use crate::{
    process::{Failure, check},
    workspace::cargo,
};

const PACKAGES: [&str; 7] = [
    "singletrack-protocol",
    "singletrack-board",
    "singletrack-control",
    "singletrack-pilot",
    "singletrack-mocap",
    "singletrack-link",
    "singletrack-analysis",
];

pub(crate) fn check_all() -> Result<(), Failure> {
    PACKAGES
        .into_iter()
        .try_for_each(|package| check(cargo().args(["check", "--quiet", "--package", package])))
}
