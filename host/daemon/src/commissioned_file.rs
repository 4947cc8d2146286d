//! The file of the passed procedures, `commissioned.json` in `state.directory`.
//!
//! Without the file, or with one that can't be read, no procedure has passed.

use std::{
    io,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use singletrack_core::{
    Config, ConfigError,
    commissioned::{Commissioned, NotCommissioned, Procedure, ProcedureResult, Subject},
    configuration_hash,
};

use crate::{clock::wall_ns, state_file::JsonFile};

/// The name of the file in `state.directory`.
const NAME: &str = "commissioned.json";

/// The version of the format.
const VERSION: u32 = 1;

/// The content of the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    version: u32,
    cars: Commissioned,
}

/// What the cars have passed, and where it is kept; for several threads.
#[derive(Clone, Debug)]
pub(crate) struct CommissionedFile(Arc<Kept>);

#[derive(Debug)]
struct Kept {
    /// Locked for as long as the disk takes.
    file: Mutex<JsonFile>,
    /// Locked for short times only: every status needs it.
    cars: Mutex<Commissioned>,
}

/// The car of a configuration.
///
/// # Errors
///
/// The errors of [`configuration_hash`].
pub(crate) fn subject(config: &Config) -> Result<Subject, ConfigError> {
    Ok(Subject {
        configuration: configuration_hash(config)?,
        car_id: config.board.car_id,
    })
}

/// Why the car of this configuration may not be armed; `None` if it may, or need not have
/// passed anything.
pub fn not_commissioned(config: &Config) -> Option<String> {
    CommissionedFile::load(&config.state.directory).refusal(config)
}

impl CommissionedFile {
    /// Reads the file in `folder`. A missing file is empty; one that can't be read is reported,
    /// and counts as empty.
    pub(crate) fn load(folder: &Path) -> Self {
        let file = JsonFile::new(folder.join(NAME), VERSION);
        let content: Option<Content> = file.load("no procedure counts as passed");
        let cars = content.map_or_else(Commissioned::default, |content| content.cars);
        Self(Arc::new(Kept {
            file: Mutex::new(file),
            cars: Mutex::new(cars),
        }))
    }

    /// [`not_commissioned`] of this file.
    pub(crate) fn refusal(&self, config: &Config) -> Option<String> {
        if !config.supervisor.require_calibration {
            return None;
        }
        match subject(config) {
            Ok(subject) => {
                let missing = self.cars().missing(subject, now_s());
                missing.map(|missing| missing.to_string())
            }
            Err(error) => Some(error.to_string()),
        }
    }

    /// What has to be done before a procedure may begin or go on; `None` for every other result.
    pub(crate) fn missing_before(
        &self,
        procedure: Procedure,
        result: ProcedureResult,
        subject: Subject,
    ) -> Option<NotCommissioned> {
        match result {
            ProcedureResult::Begun | ProcedureResult::Resumed => {
                self.cars()
                    .missing_before(procedure, result, subject, now_s())
            }
            _ => None,
        }
    }

    /// Records the state of a procedure, and replaces the file. If a failure can't be written, the
    /// file is deleted.
    ///
    /// # Errors
    ///
    /// The system's error: the state is forgotten at the end of the process.
    pub(crate) fn note(
        &self,
        procedure: Procedure,
        result: ProcedureResult,
        subject: Subject,
    ) -> io::Result<()> {
        // From here on: two results must not overtake each other on their way to the disk.
        let file = self.0.file.lock().unwrap_or_else(PoisonError::into_inner);
        let content = {
            let mut cars = self.cars();
            cars.note(procedure, result, subject, now_s());
            Content {
                version: VERSION,
                cars: cars.clone(),
            }
        };
        file.replace(&content).or_else(|error| match result {
            ProcedureResult::Failed => file.delete_after(error),
            _ => Err(error),
        })
    }

    /// For the status: the results on the car of this configuration, and what is missing.
    pub(crate) fn view(&self, subject: Subject) -> Value {
        let cars = self.cars();
        let result = |procedure: Procedure| {
            let mut results = cars.of_car(subject.car_id);
            results
                .find(|entry| entry.procedure == procedure)
                .map(|entry| {
                    json!({
                        "time_s": entry.time_s,
                        "of_this_configuration": entry.configuration == subject.configuration,
                    })
                })
        };
        let missing = cars.missing(subject, now_s());
        json!({
            "car_id": subject.car_id,
            "doctor": result(Procedure::Doctor),
            "bring_up": result(Procedure::BringUp),
            "calibrate": result(Procedure::Calibrate),
            "missing": missing.map(|missing| missing.procedure.name()),
        })
    }

    fn cars(&self) -> MutexGuard<'_, Commissioned> {
        self.0.cars.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn now_s() -> u64 {
    wall_ns() / 1_000_000_000
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn car(folder: &Path) -> Config {
        let text = include_str!("../singletrackd.example.toml");
        let mut config = Config::from_toml(text).unwrap();
        config.state.directory = folder.to_owned();
        config
    }

    fn pass_all(config: &Config) {
        let file = CommissionedFile::load(&config.state.directory);
        for procedure in Procedure::ALL {
            let subject = subject(config).unwrap();
            file.note(procedure, ProcedureResult::Passed, subject)
                .unwrap();
        }
    }

    #[test]
    fn what_a_car_has_passed_is_known_after_a_restart_and_counts_for_its_configuration_alone() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = car(&folder.path().join("state"));
        assert!(not_commissioned(&config).unwrap().contains("doctor"));
        pass_all(&config);
        assert_eq!(not_commissioned(&config), None);
        config.limits.max_speed_m_s = 1.0;
        assert_eq!(not_commissioned(&config), None);
        config.board.servo.centre_us += 10;
        let refusal = not_commissioned(&config).unwrap();
        assert!(refusal.contains("another configuration"), "{refusal}");
        config.supervisor.require_calibration = false;
        assert_eq!(not_commissioned(&config), None);
    }

    #[test]
    fn a_status_does_not_wait_for_a_disk_that_takes_a_result() {
        let folder = tempfile::tempdir().unwrap();
        let config = car(folder.path());
        let subject = subject(&config).unwrap();
        let file = CommissionedFile::load(folder.path());
        // Who opens a pipe to write waits for a reader, as for a disk.
        let pipe = folder.path().join("commissioned.json.new");
        mkfifo(&pipe);
        let notes = file.clone();
        let note = std::thread::spawn(move || {
            notes.note(Procedure::Doctor, ProcedureResult::Passed, subject)
        });
        let (viewed_in, viewed) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            while file.view(subject)["missing"] != "bring-up" {
                std::thread::yield_now();
            }
            let _ = viewed_in.send(());
        });
        let viewed = viewed.recv_timeout(std::time::Duration::from_secs(20));
        assert!(!note.is_finished(), "the disk takes it still");
        let read = fs::read_to_string(&pipe);
        assert_eq!(viewed, Ok(()));
        assert!(read.unwrap().contains("doctor"));
        // A pipe can't be synced.
        note.join().unwrap().unwrap_err();
    }

    fn mkfifo(path: &Path) {
        use rustix::fs::{CWD, FileType, Mode, mknodat};
        mknodat(CWD, path, FileType::Fifo, Mode::RWXU, 0).unwrap();
    }

    #[test]
    fn a_damaged_file_proves_nothing_and_a_failure_takes_a_result_back() {
        let folder = tempfile::tempdir().unwrap();
        let config = car(folder.path());
        pass_all(&config);
        let path = folder.path().join(NAME);
        let good = fs::read_to_string(&path).unwrap();
        for bad in ["", "{}", &good[..good.len() / 2], &"x".repeat(70_000)] {
            fs::write(&path, bad).unwrap();
            assert!(not_commissioned(&config).is_some(), "{bad:.20}");
        }
        fs::write(&path, good.replace("\"version\": 1", "\"version\": 2")).unwrap();
        assert!(not_commissioned(&config).is_some());
        fs::write(&path, &good).unwrap();
        assert_eq!(not_commissioned(&config), None);
        // The name of the new file is taken: it can't be written.
        fs::create_dir(folder.path().join("commissioned.json.new")).unwrap();
        let file = CommissionedFile::load(folder.path());
        let subject = subject(&config).unwrap();
        file.note(Procedure::Doctor, ProcedureResult::Failed, subject)
            .unwrap();
        assert!(file.refusal(&config).is_some());
        assert!(not_commissioned(&config).is_some());
    }
}
