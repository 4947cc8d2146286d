//! Each pure package must build alone. In the workspace's build a package has the
//! features that any other asks for, which hides the ones that it forgot. For the packages
//! of the host that would take longer than it is worth: they are not used one by one.

use crate::{
    process::{Failure, check},
    workspace::cargo,
};

const PACKAGES: [&str; 6] = [
    "singletrack-protocol",
    "singletrack-board",
    "singletrack-control",
    "singletrack-mocap",
    "singletrack-link",
    "singletrack-analysis",
];

pub(crate) fn check_all() -> Result<(), Failure> {
    PACKAGES
        .into_iter()
        .try_for_each(|package| check(cargo().args(["check", "--quiet", "--package", package])))
}
