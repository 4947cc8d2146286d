//! `singletrackd`: drives the car.

mod check;
mod log;
mod service;
mod signals;

use std::{path::PathBuf, process::ExitCode};

use clap::Parser;
use singletrack_core::Config;
use singletrackd::{Daemon, StartOptions, not_commissioned, notify::ServiceManager};
use tracing::{error, info, warn};

use check::StandArgument;
use log::{LogFormat, start_log};
use service::Service;
use signals::Signals;

/// Drives the car: motion capture in, commands to the board out, 100 times a second.
///
/// The car is armed by a request on the control socket, or by --arm. SIGTERM and SIGINT
/// slow the car down, disarm the board and end; a second one disarms at once. SIGHUP
/// reloads the configuration while the car does not drive; if the terminal that started
/// the daemon has been closed, SIGHUP ends it.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// The configuration; singletrackd.example.toml explains every key
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Arm once, as soon as every arming check passes: the car then moves by itself
    ///
    /// A configuration that --check finds impossible is not armed.
    #[arg(long)]
    arm: bool,
    /// With --arm: also if doctor, bring-up and calibrate have not passed with this configuration
    ///
    /// The car then drives with values that have not been measured on it.
    #[arg(long, requires = "arm")]
    uncalibrated: bool,
    /// Judge the configuration, and end: mistakes, values left as in the example, and whether
    /// the car can drive its reference inside the geofence
    ///
    /// Warnings go to stderr. The exit status is 1 if the car can't do what is asked, and 2 if
    /// the configuration is invalid.
    #[arg(long)]
    check: bool,
    /// With --check: judge the geofence from where the car stands, in m and degrees
    #[arg(
        long,
        value_name = "X,Y,YAW",
        requires = "check",
        allow_hyphen_values = true
    )]
    start: Option<StandArgument>,
    /// The format of the log on stderr. `RUST_LOG` filters it; `NO_COLOR` turns colours off
    #[arg(long, value_enum, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
}

/// The exit status for a missing or invalid configuration. The service unit relies on it.
const BAD_CONFIGURATION: u8 = 2;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    // Before any thread is started: threads inherit the mask.
    let signals = match Signals::block() {
        Ok(signals) => signals,
        Err(error) => {
            eprintln!("singletrackd: can't block signals: {error}");
            return ExitCode::FAILURE;
        }
    };
    let Some(path) = &arguments.config else {
        eprintln!(
            "singletrackd needs a configuration: singletrackd --config FILE\n\n\
             These keys have no default: serial.port, motion_capture.server, .rigid_body and .up_axis,\n\
             [law], [outer_loop] and [reference], and the calibration in [board].\n\
             singletrackd.example.toml explains every key."
        );
        return ExitCode::from(BAD_CONFIGURATION);
    };
    let config = match Config::read(path) {
        Ok(config) => config,
        Err(error) => {
            eprintln!("singletrackd: {error}");
            return ExitCode::from(BAD_CONFIGURATION);
        }
    };
    if arguments.check {
        let stand = arguments.start.map(|StandArgument(stand)| stand);
        return check::run(path, &config, stand);
    }
    let _log = start_log(arguments.log_format);
    info!(version = env!("CARGO_PKG_VERSION"), config = %path.display(), "singletrackd starts");
    let is_possible = check::log(&config);
    if arguments.arm && !is_possible {
        error!(
            "--arm: not armed: the car can't drive its reference; change the configuration, or set \
             another reference and arm with `singletrack arm`"
        );
    }
    let refusal = (arguments.arm && !arguments.uncalibrated)
        .then(|| not_commissioned(&config))
        .flatten();
    if let Some(refusal) = &refusal {
        error!("--arm: not armed: {refusal}");
    }
    let options = StartOptions {
        // A client's request to arm is refused for the same configuration.
        arm: arguments.arm && is_possible && refusal.is_none(),
        lock_memory: true,
        config_path: Some(path.clone()),
        ..StartOptions::default()
    };
    let manager = ServiceManager::from_environment().unwrap_or_else(|error| {
        warn!("the service manager is not notified: {error}");
        ServiceManager::default()
    });
    match Daemon::start(config, options) {
        Ok(daemon) => Service::new(daemon, path.clone(), manager).run(&signals),
        Err(error) => {
            error!("{error}");
            ExitCode::FAILURE
        }
    }
}
