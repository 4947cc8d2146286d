//! `singletrackd --check`: judges a configuration without driving.

use std::{path::Path, process::ExitCode};

use rustix::fs::{Access, access};
use singletrack_core::{
    Config,
    feasibility::{Finding, Severity, Stand, judge},
};

/// The exit status for a missing or invalid configuration. The service unit relies on it.
pub(crate) const BAD_CONFIGURATION: u8 = 2;

/// Judges the configuration, and prints what it found: what is impossible and what should be
/// looked at on stderr, the result on stdout.
pub(crate) fn run(path: &Path, config: &Config, stand: Option<Stand>) -> ExitCode {
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

/// Logs what [`run`] would print. The daemon starts in any case: a client may set another
/// reference. Returns whether the car can drive its reference from some place.
pub(crate) fn log(config: &Config) -> bool {
    // An error is reported by the start.
    let judgement = judge(config, None).unwrap_or_default();
    for finding in &judgement.findings {
        match finding.severity {
            Severity::Warning => tracing::warn!("{finding}"),
            Severity::Impossible => tracing::error!("{finding}"),
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
