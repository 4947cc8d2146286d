//! `singletrack calibrate`: what only the floor shows about a car.

use std::process::ExitCode;

use clap::Args;
use singletrack_commissioning::calibrate;

use crate::bench::{self, BenchArgs, BenchError, Procedure};

/// Options of `singletrack calibrate`.
#[derive(Clone, Debug, Args)]
pub struct CalibrateArgs {
    #[command(flatten)]
    bench: BenchArgs,
}

const CALIBRATE: Procedure = Procedure {
    name: "calibrate",
    command: "calibrate",
    required: true,
    about: "The calibration drives: the car stands on the free floor, nobody is inside the \
            geofence, and it moves only while you hold the space bar. It begins with 0.3 m/s, and \
            takes about 15 minutes. Ctrl-C interrupts it; the same command resumes it.",
    steps: &calibrate::STEPS,
    next: "The car is ready to be armed: singletrack arm.",
};

/// Runs the calibration. The status is 0 if no step failed, otherwise 3.
///
/// # Errors
///
/// It was interrupted, or files can't be read or written.
pub fn run(args: &CalibrateArgs) -> Result<ExitCode, BenchError> {
    bench::run(&CALIBRATE, &args.bench)
}
