//! `singletrack doctor`: what can be found about a car that does not drive.

use std::process::ExitCode;

use clap::Args;
use singletrack_commissioning::doctor;

use crate::bench::{self, BenchArgs, BenchError, Procedure};

/// Options of `singletrack doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    #[command(flatten)]
    bench: BenchArgs,
    /// Measure the IMU's noise with the wheels turning, on a stand, and nothing else
    #[arg(long)]
    stand: bool,
}

const DOCTOR: Procedure = Procedure {
    name: "doctor",
    command: "doctor",
    required: true,
    about: "The doctor moves nothing: the car stays disarmed, and your hands move it where that \
            is needed. It takes about 15 minutes. Ctrl-C interrupts it; the same command resumes \
            it.",
    steps: &doctor::STEPS,
    next: "Next: singletrack bring-up, with the wheels off the floor.",
};

const ON_STAND: Procedure = Procedure {
    name: "imu-on-stand",
    command: "doctor --stand",
    required: false,
    about: "The doctor turns the motor: the car stands on a stand in view of the cameras, with all \
            wheels off the floor, and your hand is on the supply of the ESC. It moves only while \
            you hold the space bar, and it takes about three minutes.",
    steps: &doctor::STAND_STEPS,
    next: "The floor shakes more than a stand: compare `noise` of `singletrack judge` after a drive.",
};

/// Runs the doctor. The status is 0 if no step failed, otherwise 3.
///
/// # Errors
///
/// It was interrupted, or files can't be read or written.
pub fn run(args: &DoctorArgs) -> Result<ExitCode, BenchError> {
    let procedure = if args.stand { &ON_STAND } else { &DOCTOR };
    bench::run(procedure, &args.bench)
}
