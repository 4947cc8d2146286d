//! The commands for a car and its records: everything but the demo, the simulation and the plots.

pub mod accept;
pub mod arm;
pub mod bench;
pub mod cameras;
pub mod control;
pub mod drive;
pub mod dump;
mod entries;
pub mod fleet;
pub mod jog;
pub mod records;
pub mod replay;
pub mod setpoint;
pub mod status;
pub(crate) mod terminal;

use std::process::ExitCode;

use clap::Subcommand;

use crate::Result;

/// One of these commands.
#[derive(Subcommand)]
pub enum OperatorCommand {
    /// Look at the motion capture without a daemon: its bodies, rate, jitter, latency and ghosts.
    ///
    /// The exit status is 1 if no server sends poses.
    Cameras(cameras::CamerasArgs),
    /// Check a new car without moving it, and measure what a hand can show; with --stand, how much
    /// the IMU vibrates with turning wheels.
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    Doctor(bench::DoctorArgs),
    /// Calibrate servo and ESC, wheels off the floor (after the doctor).
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    BringUp(bench::BenchArgs),
    /// Drive slowly on the floor to measure steering, motor and brakes: after bring-up.
    ///
    /// The exit status is 0 if no step failed, 1 if it was interrupted, and 3 if a step failed.
    Calibrate(bench::BenchArgs),
    /// Write what drives say of the calibration into the configuration, after showing the change.
    Accept(accept::AcceptArgs),
    /// Print or count the messages of a record, of the running daemon, or of the serial line.
    Dump(dump::DumpArgs),
    /// Make a record of the log of another program.
    Import(records::ImportArgs),
    /// Repair a truncated or damaged record.
    Recover(records::RecoverArgs),
    /// Run the pilot on a record's inputs again and compare its outputs with the recorded ones.
    Replay(replay::ReplayArgs),
    /// Print what the daemon does: mode, reason, what to do about it, and what the car senses.
    Status(status::StatusArgs),
    /// Arm the car and start driving; the drive ends when this command does.
    ///
    /// With --for the drive ends after a time, with --unattended it does not end by itself. The
    /// exit status is 0 if the drive ended as wanted, 1 if the car was not armed or the
    /// connection was lost, and 3 if something else stopped the car.
    Arm(arm::ArmArgs),
    /// Give servo and ESC bare pulses, with the wheels off the floor, while this command runs.
    Jog(jog::JogArgs),
    /// Slow down, stop and disarm.
    Disarm(control::DisarmArgs),
    /// Emergency stop: neutral at once, until the board is reset.
    Stop(control::ControlArgs),
    /// One command for several cars, each with a daemon of its own.
    Fleet(fleet::FleetArgs),
    /// Replace the reference of a standing car; it lasts until the configuration is reloaded.
    SetReference(control::SetReferenceArgs),
    /// Stream set-points from standard input to a car whose reference is external.
    Setpoint(setpoint::SetpointArgs),
    /// Change gains or p within the bounds of the configuration, also while the car drives.
    Tune(control::TuneArgs),
    /// Drive with a game-pad: one button lets the car drive itself, the other enables the sticks.
    Drive(drive::DriveArgs),
}

/// Runs a command.
///
/// # Errors
///
/// In words for the user.
pub fn run(command: &OperatorCommand) -> Result<ExitCode> {
    use OperatorCommand as Of;
    match command {
        Of::Cameras(args) => return cameras::run(args),
        Of::Doctor(args) => return bench::run(args.procedure(), &args.bench),
        Of::BringUp(args) => return bench::run(&bench::BRING_UP, args),
        Of::Calibrate(args) => return bench::run(&bench::CALIBRATE, args),
        Of::Accept(args) => accept::run(args)?,
        Of::Dump(args) => dump::run(args)?,
        Of::Import(args) => records::import(args)?,
        Of::Recover(args) => records::recover(args)?,
        Of::Replay(args) => return replay::run(args),
        Of::Status(args) => status::run(args)?,
        Of::Arm(args) => return arm::run(args),
        Of::Jog(args) => return jog::run(args),
        Of::Disarm(args) => control::disarm(args)?,
        Of::Stop(args) => control::stop(args)?,
        Of::Fleet(args) => return fleet::run(args),
        Of::SetReference(args) => control::set_reference(args)?,
        Of::Setpoint(args) => setpoint::run(args)?,
        Of::Tune(args) => control::tune(args)?,
        Of::Drive(args) => return drive::run(args),
    }
    Ok(ExitCode::SUCCESS)
}
