//! Each pure package must build alone. In the workspace's build a package has the
//! features that any other asks for, which hides the ones that it forgot. The packages of
//! the host are not checked so: it takes minutes, and those that users build alone (`cargo
//! demo`, `cargo faults`) fail at once, and visibly, if they forget one.

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
