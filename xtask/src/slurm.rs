//! Checks campaigns as job arrays on a Slurm of one node.

use std::process::Command;

use crate::{
    process::{Failure, check as run},
    release::Release,
    workspace::root,
};

pub(crate) fn check(release: Release) -> Result<(), Failure> {
    let program = release.path("singletrack-faults")?;
    release.path("singletrack")?;
    let folder = program
        .parent()
        .ok_or_else(|| Failure::new(format!("{} has no folder", program.display())))?;
    run(Command::new(root().join("tests/slurm/job-array.sh"))
        .arg(folder)
        // A Slurm that is installed does not count.
        .env_remove("SLURM_CONF"))
}
