//! Change of the configuration while the control loop runs.
//!
//! The caller reads, checks and builds the configuration and hands it to the control loop
//! in a box. The loop returns the box, and the caller frees it: the loop reads no file,
//! never waits and frees no memory. A refused configuration has no effect.

use std::{
    path::{Component, Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
};

use rtrb::Consumer;

use crate::{
    config::{Config, ConfigError, ReferenceSection, restart_keys},
    run::messages::{ControlRequest, Reconfiguration, Refusal, Requests, Stalled},
    run::proof::configuration_hash,
};

/// The longest time until the control loop takes a change, in ns: many ticks.
pub const CHANGE_TIMEOUT_NS: u64 = 200_000_000;

/// Why the configuration in force stays.
#[derive(Debug, thiserror::Error)]
pub enum ChangeError {
    /// The new configuration is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// It differs in keys that are only read at the start.
    #[error(
        "{} can't change while singletrackd runs: restart it, or take {} back",
        .0.join(", "),
        if .0.len() == 1 { "that" } else { "those" }
    )]
    Restart(Vec<String>),
    /// It can't be compared with the one in force.
    #[error("{0}; every path must be UTF-8")]
    Path(#[from] toml::ser::Error),
    /// The control loop refused it.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The control loop takes no requests.
    #[error(transparent)]
    Stalled(#[from] Stalled),
    /// A reference file with a relative path, which depends on the reader's folder.
    #[error("reference.file is {}: a daemon needs an absolute path", .0.display())]
    RelativePath(PathBuf),
    /// A reference file that a client may not name.
    #[error(
        "reference.file is {}: clients of the socket may name files in {} only; copy it there, or set \
         socket.reference_folder",
        file.display(), folder.display()
    )]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Where files may be.
        folder: PathBuf,
    },
}

/// The configuration in force, and the change that is underway.
#[derive(Debug)]
pub struct Configurations {
    /// The configuration in force.
    pub in_force: Config,
    /// Its number.
    pub number: u32,
    returned: Consumer<Box<Reconfiguration>>,
    under_way: Option<Config>,
    /// For the camera receiver, which is not stopped for a change.
    stamp_offset_ns: Arc<AtomicI64>,
}

impl Configurations {
    /// `config` is in force, with the number 1; `returned` is the ring on which boxes
    /// are returned. The camera receiver reads `stamp_offset_ns`.
    pub const fn new(
        config: Config,
        returned: Consumer<Box<Reconfiguration>>,
        stamp_offset_ns: Arc<AtomicI64>,
    ) -> Self {
        Self {
            in_force: config,
            number: 1,
            returned,
            under_way: None,
            stamp_offset_ns,
        }
    }

    /// The configuration in force with another reference, from a client that may name files in
    /// `socket.reference_folder`, or in `folder` if there is none.
    ///
    /// # Errors
    ///
    /// The reference is invalid or contradicts the rest of the configuration.
    pub fn with_reference(
        &self,
        reference: ReferenceSection,
        folder: &Path,
    ) -> Result<Config, ChangeError> {
        if let Some(file) = reference.file() {
            let chosen = self.in_force.socket.reference_folder.as_deref();
            check_file(file, chosen.unwrap_or(folder))?;
        }
        let config = Config {
            reference,
            ..self.in_force.clone()
        };
        config.validate()?;
        Ok(config)
    }

    /// Whether a change is under way: another can't begin before [`settle`](Self::settle).
    pub const fn is_changing(&self) -> bool {
        self.under_way.is_some()
    }

    /// Hands `config` to the control loop, which refuses it after `until_ns`.
    /// [`settle`](Self::settle) returns the outcome.
    ///
    /// # Errors
    ///
    /// The reason why it can't be handed over. The configuration in force stays.
    pub fn begin(
        &mut self,
        mut config: Config,
        until_ns: u64,
        requests: &Requests,
    ) -> Result<(), ChangeError> {
        if self.is_changing() {
            return Err(Stalled.into());
        }
        config.reference = config.reference.with_points_inlined()?;
        let keys = restart_keys(&self.in_force, &config)?;
        if !keys.is_empty() {
            return Err(ChangeError::Restart(keys));
        }
        let change = Box::new(Reconfiguration {
            number: self.number.wrapping_add(1),
            pilot: config.pilot()?,
            board: config.board_configuration(),
            steering: config.steering_map()?,
            hash: configuration_hash(&config)?,
            until_ns,
            outcome: None,
        });
        requests.push(ControlRequest::Reconfigure(change))?;
        self.under_way = Some(config);
        Ok(())
    }

    /// Handles the outcome of the change that is underway, and returns the number of the
    /// configuration in force; `None` while there is no outcome.
    pub fn settle(&mut self) -> Option<Result<u32, ChangeError>> {
        let change = self.returned.pop().ok()?;
        let config = self.under_way.take()?;
        match change.outcome {
            Some(Ok(())) => {}
            Some(Err(refusal)) => return Some(Err(refusal.into())),
            None => return Some(Err(Stalled.into())),
        }
        let offset_ns = config.motion_capture.timing.stamp_offset_ns();
        self.stamp_offset_ns.store(offset_ns, Ordering::Relaxed);
        self.in_force = config;
        self.number = change.number;
        Some(Ok(self.number))
    }
}
/// Whether a client may name this file. One outside the folder is not looked at.
fn check_file(file: &Path, folder: &Path) -> Result<(), ChangeError> {
    if !file.is_absolute() {
        return Err(ChangeError::RelativePath(file.to_owned()));
    }
    let real_folder = folder.canonicalize();
    let is_inside = |file: &Path| {
        file.starts_with(folder) || matches!(&real_folder, Ok(folder) if file.starts_with(folder))
    };
    // Without `..`, as it is written; then as it is on the disk.
    let mut written = PathBuf::new();
    for part in file.components() {
        if part == Component::ParentDir {
            written.pop();
        } else {
            written.push(part);
        }
    }
    let leaves = || file.canonicalize().is_ok_and(|real| !is_inside(&real));
    if !is_inside(&written) || leaves() {
        return Err(ChangeError::Foreign {
            file: file.to_owned(),
            folder: folder.to_owned(),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::symlink};

    use super::*;

    #[test]
    fn a_client_names_files_in_its_folder_only() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("references");
        fs::create_dir(&folder).unwrap();
        let secret = home.path().join("secret");
        for file in [&secret, &folder.join("path.csv")] {
            fs::write(file, "").unwrap();
        }
        symlink(&secret, folder.join("link")).unwrap();
        let link = home.path().join("other-name");
        symlink(&folder, &link).unwrap();
        for (file, folder) in [
            ("path.csv", &folder),
            ("missing", &folder),
            ("path.csv", &link),
        ] {
            check_file(&folder.join(file), folder).unwrap();
        }
        check_file(&folder.canonicalize().unwrap().join("path.csv"), &link).unwrap();
        check_file(&folder.join("../references/path.csv"), &folder).unwrap();
        for file in [&secret, &folder.join("../secret"), &folder.join("link")] {
            let error = check_file(file, &folder).unwrap_err();
            assert!(matches!(error, ChangeError::Foreign { .. }), "{error}");
            assert!(error.to_string().contains("socket.reference_folder"));
        }
        let error = check_file(Path::new("/proc/self/environ"), &folder).unwrap_err();
        assert!(matches!(error, ChangeError::Foreign { .. }), "{error}");
    }
}
