//! The file of the passed procedures, `commissioned.json` in `state.directory`.
//!
//! Without the file, or with one that can't be read, no procedure has passed. It is replaced as
//! a whole, so that a loss of power leaves the old one or the new one.

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use singletrack_core::{
    Config, ConfigError,
    commissioned::{Commissioned, NotCommissioned, Procedure, ProcedureResult, Subject},
    configuration_hash,
};

use crate::clock::wall_ns;

/// The name of the file in `state.directory`.
const NAME: &str = "commissioned.json";

/// The version of the format. A file of another one counts as absent.
const VERSION: u32 = 1;

/// Longer than every valid file, in bytes.
const LONGEST: u64 = 65_536;

/// The content of the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    version: u32,
    cars: Commissioned,
}

/// What the cars have passed, and where it is kept; for several threads.
#[derive(Clone, Debug)]
pub(crate) struct CommissionedFile(Arc<Mutex<Kept>>);

#[derive(Debug)]
struct Kept {
    path: PathBuf,
    cars: Commissioned,
}

/// The car of a configuration.
///
/// # Errors
///
/// As [`configuration_hash`].
pub(crate) fn subject(config: &Config) -> Result<Subject, ConfigError> {
    Ok(Subject {
        configuration: configuration_hash(config)?,
        car_id: config.board.car_id,
    })
}

/// Why the car of this configuration may not be armed; `None` if it may, or need not have
/// passed anything.
#[must_use]
pub fn not_commissioned(config: &Config) -> Option<String> {
    CommissionedFile::load(&config.state.directory).refusal(config)
}

impl CommissionedFile {
    /// Reads the file in `folder`. A missing file is empty; one that can't be read is reported,
    /// and counts as empty.
    pub(crate) fn load(folder: &Path) -> Self {
        let path = folder.join(NAME);
        let cars = match read(&path) {
            Ok(cars) => cars,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Commissioned::default(),
            Err(error) => {
                tracing::warn!("{}: {error}; no procedure counts as passed", path.display());
                Commissioned::default()
            }
        };
        Self(Arc::new(Mutex::new(Kept { path, cars })))
    }

    /// As [`not_commissioned`].
    pub(crate) fn refusal(&self, config: &Config) -> Option<String> {
        if !config.supervisor.require_calibration {
            return None;
        }
        match subject(config) {
            Ok(subject) => self.missing(subject).map(|missing| missing.to_string()),
            Err(error) => Some(error.to_string()),
        }
    }

    fn missing(&self, subject: Subject) -> Option<NotCommissioned> {
        self.lock().cars.missing(subject, now_s())
    }

    /// Takes note of what became of a procedure, and replaces the file.
    ///
    /// # Errors
    ///
    /// The system's error: what was noted is forgotten at the end of the process. A result that
    /// was taken back is not in the file in any case, unless that can't be deleted either.
    pub(crate) fn note(
        &self,
        procedure: Procedure,
        result: ProcedureResult,
        subject: Subject,
    ) -> io::Result<()> {
        let mut kept = self.lock();
        kept.cars.note(procedure, result, subject, now_s());
        kept.write().or_else(|error| {
            if result == ProcedureResult::Failed {
                // The first error says more than that of the deletion.
                fs::remove_file(&kept.path).map_err(|_| error)
            } else {
                Err(error)
            }
        })
    }

    /// For the status: the results on the car of this configuration, and what is missing.
    pub(crate) fn view(&self, subject: Subject) -> Value {
        let kept = self.lock();
        let result = |procedure: Procedure| {
            let mut results = kept.cars.of_car(subject.car_id);
            results
                .find(|entry| entry.procedure == procedure)
                .map(|entry| {
                    json!({
                        "time_s": entry.time_s,
                        "of_this_configuration": entry.configuration == subject.configuration,
                    })
                })
        };
        let missing = kept.cars.missing(subject, now_s());
        json!({
            "car_id": subject.car_id,
            "doctor": result(Procedure::Doctor),
            "bring_up": result(Procedure::BringUp),
            "calibrate": result(Procedure::Calibrate),
            "missing": missing.map(|missing| missing.procedure.name()),
        })
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn write(&self) -> io::Result<()> {
        let content = Content {
            version: VERSION,
            cars: self.cars.clone(),
        };
        let folder = self.path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        let new = self.path.with_extension("json.new");
        let mut file = File::create(&new)?;
        serde_json::to_writer_pretty(&mut file, &content)?;
        file.write_all(b"\n")?;
        file.sync_all()?;
        fs::rename(&new, &self.path)?;
        // The rename itself must survive a loss of power too.
        File::open(folder)?.sync_all()
    }
}

fn now_s() -> u64 {
    wall_ns() / 1_000_000_000
}

fn read(path: &Path) -> io::Result<Commissioned> {
    let length = fs::metadata(path)?.len();
    if length > LONGEST {
        return Err(io::Error::other(format!(
            "it is {length} bytes long, at most {LONGEST} are valid"
        )));
    }
    let text = fs::read_to_string(path)?;
    let content: Content = serde_json::from_str(&text)
        .map_err(|error| io::Error::other(format!("it is damaged: {error}")))?;
    if content.version != VERSION {
        return Err(io::Error::other(format!(
            "its version is {}, not {VERSION}",
            content.version
        )));
    }
    Ok(content.cars)
}

#[cfg(test)]
mod tests {
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
