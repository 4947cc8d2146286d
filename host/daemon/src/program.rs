//! The program `singletrackd`.

use std::{ffi::OsString, process::ExitCode};

use clap::Parser;
use singletrack_core::{Config, certificate};
use tracing::{error, info, warn};

use crate::{
    Arguments, Daemon, StartOptions,
    check::{self, BAD_CONFIGURATION},
    log::start_log,
    not_commissioned,
    notify::ServiceManager,
    service::Service,
    signals::Signals,
};

/// Runs this command line, whose first word is the program's name.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments = Arguments::parse_from(arguments);
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
        return check::run(path, &config, arguments.start);
    }
    let _log = start_log(arguments.log_format, arguments.log_level());
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
        .flatten()
        .or_else(|| certificate::refusal(&config).filter(|_| arguments.arm));
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
