//! `singletrack doctor`: what can be found about a car without moving it.

use std::process::ExitCode;

use clap::Args;
use singletrack_commissioning::doctor;

use crate::bench::{self, BenchArgs, BenchError, Procedure};

/// Options of `singletrack doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    #[command(flatten)]
    bench: BenchArgs,
}

const DOCTOR: Procedure = Procedure {
    name: "doctor",
    about: "The doctor moves nothing: the car stays disarmed, and your hands move it where that \
            is needed. It takes about 15 minutes. Ctrl-C interrupts it; the same command resumes \
            it.",
    steps: &doctor::STEPS,
    next: "Next: singletrack bring-up, with the wheels off the floor.",
};

/// Runs the doctor. The status is 0 if no step failed, otherwise 3.
///
/// # Errors
///
/// It was interrupted, or files can't be read or written.
pub fn run(args: &DoctorArgs) -> Result<ExitCode, BenchError> {
    bench::run(&DOCTOR, &args.bench)
}
