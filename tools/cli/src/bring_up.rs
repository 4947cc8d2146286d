//! `singletrack bring-up`: servo and motor of a car whose wheels are off the floor.

use std::process::ExitCode;

use clap::Args;
use singletrack_commissioning::bring_up;

use crate::bench::{self, BenchArgs, BenchError, Procedure};

/// Options of `singletrack bring-up`.
#[derive(Clone, Debug, Args)]
pub struct BringUpArgs {
    #[command(flatten)]
    bench: BenchArgs,
}

const BRING_UP: Procedure = Procedure {
    name: "bring-up",
    command: "bring-up",
    required: true,
    about: "The bring-up turns servo and motor: the car stands on a stand in view of the cameras, \
            with all wheels off the floor, and your hand is on the supply of the ESC. It moves \
            only while you hold the space bar, and it takes about 40 minutes. Ctrl-C interrupts \
            it; the same command resumes it.",
    steps: bring_up::STEPS,
    next: "Next: singletrack calibrate, on the floor.",
};

/// Runs the bring-up. The status is 0 if no step failed, otherwise 3.
///
/// # Errors
///
/// It was interrupted, or files can't be read or written.
pub fn run(args: &BringUpArgs) -> Result<ExitCode, BenchError> {
    bench::run(&BRING_UP, &args.bench)
}
