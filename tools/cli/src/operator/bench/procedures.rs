//! `singletrack doctor|bring-up|calibrate`: from the parts to the first drive.

use clap::Args;
use singletrack_commissioning::{bring_up, calibrate, doctor};
use singletrack_core::Config;

use super::{BenchArgs, Procedure};

/// Options of `singletrack doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    #[command(flatten)]
    /// Those of every procedure.
    pub bench: BenchArgs,
    /// Measure the IMU's noise with the wheels turning, on a stand, and nothing else
    #[arg(long)]
    stand: bool,
}

impl DoctorArgs {
    /// The procedure that is asked for.
    pub const fn procedure(&self) -> &'static Procedure {
        if self.stand { &ON_STAND } else { &DOCTOR }
    }
}

/// A procedure that needs no floor.
const fn nothing(_: &Config) -> Option<String> {
    None
}

/// What can be found about a car that does not drive.
const DOCTOR: Procedure = Procedure {
    name: "doctor",
    command: "doctor",
    required: true,
    refuses: nothing,
    about: "The doctor moves nothing: the car stays disarmed, and your hands move it where that \
            is needed. It takes about 15 minutes. Ctrl-C interrupts it; the same command resumes \
            it.",
    steps: &doctor::STEPS,
    next: "Next: singletrack bring-up, with the wheels off the floor.",
};

/// How much the IMU vibrates with turning wheels.
const ON_STAND: Procedure = Procedure {
    name: "imu-on-stand",
    command: "doctor --stand",
    required: false,
    refuses: nothing,
    about: "The doctor turns the motor: the car stands on a stand in view of the cameras, with all \
            wheels off the floor, and your hand is on the supply of the ESC. It moves only while \
            you hold the space bar, and it takes about three minutes.",
    steps: &doctor::STAND_STEPS,
    next: "The floor shakes more than a stand: compare `noise` of `singletrack judge` after a drive.",
};

/// Servo and motor of a car whose wheels are off the floor.
pub const BRING_UP: Procedure = Procedure {
    name: "bring-up",
    command: "bring-up",
    required: true,
    refuses: nothing,
    about: "The bring-up turns servo and motor: the car stands on a stand in view of the cameras, \
            with all wheels off the floor, and your hand is on the supply of the ESC. It moves \
            only while you hold the space bar, and it takes about 40 minutes. Ctrl-C interrupts \
            it; the same command resumes it.",
    steps: bring_up::STEPS,
    next: "Next: singletrack calibrate, on the floor.",
};

/// What only the floor shows about a car.
pub const CALIBRATE: Procedure = Procedure {
    name: "calibrate",
    command: "calibrate",
    required: true,
    refuses: calibrate::lacks_room,
    about: "The calibration drives: the car stands on the free floor, nobody is inside the \
            geofence, and it moves only while you hold the space bar. It begins with 0.3 m/s, and \
            takes about 15 minutes. Ctrl-C interrupts it; the same command resumes it.",
    steps: &calibrate::STEPS,
    next: "The car is ready to be armed: singletrack arm.",
};
