//! `singletrack fleet arm`: the dead-man switch of all cars.

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Args;
use singletrack_api::{Fleet, FleetArm, FleetDrive};
use singletrackd::monotonic_ns;

use crate::interrupt::Interrupt;
use crate::operator::{
    arm::{ended_as_wanted, is_wanted, parse_time, warn},
    control::{ControlError, print},
};

/// Options of `singletrack fleet arm`.
#[derive(Clone, Debug, Args)]
pub(super) struct FleetArmArgs {
    /// Drive for this time, such as 60s, and stop
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
    /// The time until all references begin, within 10 ms of each other; the cars are armed before
    #[arg(long, value_name = "DURATION", value_parser = parse_time, default_value = "3s")]
    start_in: Duration,
    /// Stop all cars when the drive of one of them ends
    #[arg(long)]
    together: bool,
    /// Arm also cars that have not passed doctor, bring-up and calibrate
    #[arg(long)]
    uncalibrated: bool,
}

/// Arms all cars, if all are ready, and holds their drives until all have ended.
pub(super) fn run(fleet: &Fleet, args: &FleetArmArgs) -> Result<ExitCode, Box<dyn Error>> {
    let interrupt = Interrupt::listen().map_err(ControlError::from)?;
    let options = FleetArm {
        start_in: args.start_in,
        together: args.together,
        uncalibrated: args.uncalibrated,
    };
    let mut drive = FleetDrive::begin(fleet, &options, monotonic_ns)?;
    while !drive.is_over() {
        let is_over = args
            .time
            .is_some_and(|time| drive.start().elapsed() >= time);
        if interrupt.is_raised() || is_over {
            drive.disarm();
        }
        drive.step();
        warn(&drive.warnings());
    }
    let mut as_wanted = true;
    for car in drive.ends()? {
        as_wanted &= is_wanted(&car.ended);
        print(&format!("{}: {}", car.name, car.ended))?;
    }
    Ok(ended_as_wanted(as_wanted))
}
