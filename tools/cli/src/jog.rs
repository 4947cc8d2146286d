//! `singletrack jog`: bare pulses for servo and ESC, for as long as this command runs.

use std::{process::ExitCode, time::Duration};

use clap::Args;
use serde_json::json;
use singletrackd::SOCKET_VERSION;

use crate::{
    arm::{Drive, parse_time},
    control::{ControlArgs, ControlError},
    interrupt::Interrupt,
};

/// Options of `singletrack jog`.
#[derive(Clone, Debug, Args)]
pub struct JogArgs {
    #[command(flatten)]
    control: ControlArgs,
    /// Pulse of the steering servo, in us
    #[arg(long = "servo", value_name = "US", value_parser = clap::value_parser!(u16).range(800..=2_200))]
    servo_us: u16,
    /// Pulse of the ESC, in us; the board gives at most 150 us more or less than neutral
    #[arg(long = "esc", value_name = "US", value_parser = clap::value_parser!(u16).range(800..=2_200))]
    esc_us: u16,
    /// End after this time, such as 2s; otherwise with Ctrl-C
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
}

/// Arms to jog and renews the pulses ten times a second. The motor goes to neutral 0.25 s after
/// the last renewal, however this command ends.
///
/// # Errors
///
/// When the board can't be armed, or the connection is lost; the reason is the daemon's.
pub fn run(args: &JogArgs) -> Result<ExitCode, ControlError> {
    let interrupt = Interrupt::listen()?;
    let mut drive = Drive::connect(&args.control, "jogging")?;
    drive.send(&json!({
        "version": SOCKET_VERSION,
        "command": "arm",
        "attendance": "hold",
        "jog": true,
    }))?;
    let pulses = json!({
        "version": SOCKET_VERSION,
        "command": "jog",
        "servo_us": args.servo_us,
        "esc_us": args.esc_us,
    });
    drive.attend(&interrupt, &pulses, args.time)
}
