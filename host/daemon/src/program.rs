//! The program `singletrackd`; with `--check` it judges a configuration without driving.

use std::{ffi::OsString, path::Path, process::ExitCode};

use clap::Parser;
use rustix::fs::{Access, access};
use singletrack_core::{
    Config, certificate,
    feasibility::{Finding, Severity, Stand, judge},
};
use tracing::{error, info, warn};

use crate::{
    Arguments, Daemon, StartOptions, log::start_log, not_commissioned, notify::ServiceManager,
    service::Service, system::Signals,
};

/// The exit status for a missing or invalid configuration. The service unit relies on it.
const BAD_CONFIGURATION: u8 = 2;

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
        return check(path, &config, arguments.start);
    }
    let _log = start_log(arguments.log_format, arguments.log_level());
    info!(version = env!("CARGO_PKG_VERSION"), config = %path.display(), "singletrackd starts");
    let is_possible = log_judgement(&config);
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

/// Judges the configuration, and prints what it found: what is impossible and what should be
/// looked at on stderr, the result on stdout.
fn check(path: &Path, config: &Config, stand: Option<Stand>) -> ExitCode {
    let judgement = match judge(config, stand) {
        Ok(judgement) => judgement,
        Err(error) => {
            eprintln!("singletrackd: {}: {error}", path.display());
            return ExitCode::from(BAD_CONFIGURATION);
        }
    };
    for finding in judgement.findings.iter().chain(&directories(config)) {
        eprintln!("singletrackd: {}: {finding}", finding.severity.name());
    }
    if !judgement.is_possible() {
        return ExitCode::FAILURE;
    }
    println!("{}: good", path.display());
    println!(
        "control.stop_deceleration_m_s2 = {} allows limits.max_speed_m_s up to {} (with \
         board.max_pose_age_ms = 1000)",
        config.control.stop_deceleration_m_s2,
        config.fastest_stopped_m_s()
    );
    if let Some(start) = judgement.start {
        println!("the car can drive its reference from: {start}");
    }
    ExitCode::SUCCESS
}

/// Logs what [`check`] would print. The daemon starts in any case: a client may set another
/// reference. Returns whether the car can drive its reference from some place.
fn log_judgement(config: &Config) -> bool {
    // An error is reported by the start.
    let judgement = judge(config, None).unwrap_or_default();
    for finding in &judgement.findings {
        match finding.severity {
            Severity::Warning => warn!("{finding}"),
            Severity::Impossible => error!("{finding}"),
        }
    }
    judgement.is_possible()
}

/// The folders that the daemon writes to, if this user can't.
fn directories(config: &Config) -> Vec<Finding> {
    let (record, socket) = (&config.record, &config.socket);
    let (records, state) = (record.directory.as_path(), config.state.directory.as_path());
    let folders = [
        (
            "record.directory",
            Some(records).filter(|_| record.enabled),
            "choose a folder that the daemon may write to, or set record.enabled = false",
        ),
        (
            "state.directory",
            Some(state),
            "choose a folder that the daemon may write to; otherwise every drive after a restart \
             begins slowly",
        ),
        (
            "socket.path",
            socket.path.parent().filter(|_| socket.enabled),
            "choose a path in a folder that the daemon may write to, such as one in \
             $XDG_RUNTIME_DIR, or set socket.enabled = false",
        ),
    ];
    let finding = |(key, folder, fix): (_, Option<&Path>, &str)| {
        let folder = folder?;
        let refusal = unwritable(folder)?;
        let fix = format!("this user can't write there ({refusal}); {fix}");
        Some(Finding::warning(key, folder.display(), fix))
    };
    folders.into_iter().filter_map(finding).collect()
}

/// Why files can't be made in `folder`, which the daemon creates if necessary.
fn unwritable(folder: &Path) -> Option<String> {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let mut ancestors = absolute.ancestors();
    let existing = ancestors.find(|ancestor| ancestor.symlink_metadata().is_ok())?;
    if !existing.is_dir() {
        return Some(format!("{} is no folder", existing.display()));
    }
    let refused = access(existing, Access::WRITE_OK | Access::EXEC_OK).err()?;
    let error = std::io::Error::from(refused);
    Some(format!("{}: {error}", existing.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_can_be_created_is_writable_and_one_below_a_file_is_not() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(unwritable(&folder.path().join("a/b")), None);
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let refusal = unwritable(&file.join("records")).unwrap();
        assert!(refusal.contains("file is no folder"), "{refusal}");
    }
}
