//! The JSON files in `state.directory`; one is the state file: what the daemon remembers from one start
//! to the next.
//!
//! The state file holds the configurations that a car has proved on its first metre. Without the file, or
//! with one that can't be read, nothing is proved, and the next drive begins slowly: the file
//! only saves time.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use singletrack_core::{MAX_PROOFS, Proof, Proofs};

/// The name of the file in `state.directory`.
const NAME: &str = "proved.json";

/// The version of the format.
const VERSION: u32 = 1;

/// The content of the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    version: u32,
    proved: Vec<Proof>,
}

/// The proved configurations, and where they are kept.
#[derive(Debug)]
pub(crate) struct StateFile {
    file: JsonFile,
    proofs: Vec<Proof>,
    /// The last attempt to write failed: the file has other proofs.
    is_behind: bool,
}

impl StateFile {
    /// Reads the file in `folder`. A missing file is empty; one that can't be read is reported,
    /// and counts as empty.
    pub(crate) fn load(folder: &Path) -> Self {
        let file = JsonFile::new(folder.join(NAME), VERSION);
        let consequence = "nothing counts as proved: the next drive begins slowly";
        let content: Option<Content> = file.load(consequence);
        Self {
            proofs: content.map_or_else(Vec::new, |content| content.proved),
            file,
            is_behind: false,
        }
    }

    /// For the control loop.
    pub(crate) fn proofs(&self) -> Proofs {
        Proofs::of(&self.proofs)
    }

    /// Adds a proof and replaces the file.
    ///
    /// # Errors
    ///
    /// The system's error: unless [`retry`](Self::retry) succeeds, the proof is forgotten at the
    /// end of the process.
    pub(crate) fn add(&mut self, proof: Proof) -> io::Result<()> {
        if !self.proofs.contains(&proof) {
            self.proofs.push(proof);
            let too_many = self.proofs.len().saturating_sub(MAX_PROOFS);
            self.proofs.drain(..too_many);
            self.is_behind = true;
        }
        self.retry()
    }

    /// Removes a proof and replaces the file. If that fails, the file is deleted.
    ///
    /// # Errors
    ///
    /// The system's error, if the file could neither be replaced nor deleted.
    pub(crate) fn remove(&mut self, proof: Proof) -> io::Result<()> {
        let count = self.proofs.len();
        self.proofs.retain(|other| *other != proof);
        self.is_behind |= self.proofs.len() < count;
        self.retry().or_else(|error| self.file.delete_after(error))
    }

    /// Writes the file if the last attempt failed.
    ///
    /// # Errors
    ///
    /// The system's error: the file is still behind.
    pub(crate) fn retry(&mut self) -> io::Result<()> {
        if self.is_behind {
            self.file.replace(&Content {
                version: VERSION,
                proved: self.proofs.clone(),
            })?;
            self.is_behind = false;
        }
        Ok(())
    }
}

/// Longer than every valid file, in bytes.
const LONGEST: u64 = 65_536;

/// A JSON file whose content has the key `version`. It is replaced as a whole: a loss of power leaves the
/// old one or the new one.
#[derive(Clone, Debug)]
pub(crate) struct JsonFile {
    path: PathBuf,
    /// A file of another version counts as absent.
    version: u32,
}

/// The version of a content, which may have any other keys.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

impl JsonFile {
    pub(crate) fn new(path: PathBuf, version: u32) -> Self {
        Self { path, version }
    }

    /// The content, or `None` without a file. A file that can't be read also counts as absent,
    /// and is logged together with the `consequence`.
    pub(crate) fn load<T: DeserializeOwned>(&self, consequence: &str) -> Option<T> {
        match self.read() {
            Ok(content) => Some(content),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => {
                tracing::warn!("{}: {error}; {consequence}", self.path.display());
                None
            }
        }
    }

    /// The content.
    ///
    /// # Errors
    ///
    /// The system's error, or why the file is not valid.
    pub(crate) fn read<T: DeserializeOwned>(&self) -> io::Result<T> {
        let length = fs::metadata(&self.path)?.len();
        if length > LONGEST {
            return Err(io::Error::other(format!(
                "it is {length} bytes long, at most {LONGEST} are valid"
            )));
        }
        let text = fs::read_to_string(&self.path)?;
        let damaged = |error| io::Error::other(format!("it is damaged: {error}"));
        let Version { version } = serde_json::from_str(&text).map_err(damaged)?;
        if version != self.version {
            return Err(io::Error::other(format!(
                "its version is {version}, not {}",
                self.version
            )));
        }
        serde_json::from_str(&text).map_err(damaged)
    }

    /// Replaces the file, and creates its folder if needed.
    ///
    /// # Errors
    ///
    /// The system's error: the file is as before.
    pub(crate) fn replace(&self, content: &impl Serialize) -> io::Result<()> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        let mut text = serde_json::to_vec_pretty(content)?;
        text.push(b'\n');
        singletrack_record::replace(&self.path, &text)
    }

    /// Deletes a file that could not be replaced, which also works on a full disk: rather no
    /// result than a wrong one.
    ///
    /// # Errors
    ///
    /// The `error` of the replacement, which says more than that of the deletion.
    pub(crate) fn delete_after(&self, error: io::Error) -> io::Result<()> {
        fs::remove_file(&self.path).map_err(|_| error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &Path) -> io::Result<Vec<Proof>> {
        let content: Content = JsonFile::new(path.to_owned(), VERSION).read()?;
        Ok(content.proved)
    }

    const PROOFS: [Proof; 2] = [
        Proof {
            // Beyond what a number in JSON can hold.
            configuration: u64::MAX - 1,
            car_id: 7,
        },
        Proof {
            configuration: 5,
            car_id: 0,
        },
    ];

    #[test]
    fn what_was_proved_is_known_after_a_restart_and_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        // The folder is created.
        let folder = folder.path().join("state");
        let mut state = StateFile::load(&folder);
        assert_eq!(state.proofs(), Proofs::default());
        for proof in PROOFS {
            state.add(proof).unwrap();
        }
        let proofs = StateFile::load(&folder).proofs();
        assert!(PROOFS.iter().all(|proof| proofs.contains(*proof)));
        assert!(!proofs.contains(Proof {
            configuration: 5,
            car_id: 7
        }));
        // Nothing is left of the replacement.
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    }

    #[test]
    fn a_damaged_file_proves_nothing_and_is_replaced_by_the_next_proof() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(NAME);
        let good = r#"{"version":1,"proved":[{"configuration":"0000000000000005","car_id":0}]}"#;
        fs::write(&path, good).unwrap();
        assert_eq!(read(&path).unwrap(), PROOFS[1..]);
        for (text, why) in [
            ("", "damaged"),
            (&good[..40], "damaged"),
            (
                &good.replace("\"version\":1", "\"version\":2"),
                "version is 2",
            ),
            (&good.replace("0005", "5"), "damaged"),
            (&good.replace("0005", "000g"), "damaged"),
            (&good.replace("car_id", "car"), "damaged"),
            (&"x".repeat(70_000), "70000 bytes"),
        ] {
            fs::write(&path, text).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains(why), "{text}: {error}");
            let mut state = StateFile::load(folder.path());
            assert_eq!(state.proofs(), Proofs::default());
            state.add(PROOFS[0]).unwrap();
            assert_eq!(read(&path).unwrap(), PROOFS[..1]);
        }
    }

    #[test]
    fn the_oldest_of_too_many_proofs_are_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let mut state = StateFile::load(folder.path());
        let proof = |configuration| Proof {
            configuration,
            car_id: 1,
        };
        for configuration in 0..=MAX_PROOFS as u64 {
            state.add(proof(configuration)).unwrap();
        }
        let proofs = StateFile::load(folder.path()).proofs();
        assert!(!proofs.contains(proof(0)) && proofs.contains(proof(1)));
    }

    #[test]
    fn a_folder_that_cannot_be_written_to_is_an_error_of_the_addition_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let mut state = StateFile::load(&file);
        assert!(state.add(PROOFS[0]).is_err());
        assert!(
            state.proofs().contains(PROOFS[0]),
            "until the end of the process"
        );
    }

    /// Makes every write in the folder fail, also for root: the name of the new file is taken.
    fn obstruct(folder: &Path) -> PathBuf {
        let obstacle = folder.join("proved.json.new");
        fs::create_dir(&obstacle).unwrap();
        obstacle
    }

    #[test]
    fn a_proof_that_could_not_be_written_is_written_by_the_next_attempt() {
        let folder = tempfile::tempdir().unwrap();
        let obstacle = obstruct(folder.path());
        let mut state = StateFile::load(folder.path());
        assert!(state.add(PROOFS[0]).is_err());
        // It is not taken for written because it is known.
        assert!(state.add(PROOFS[0]).is_err());
        assert!(state.retry().is_err());
        fs::remove_dir(obstacle).unwrap();
        state.retry().unwrap();
        assert_eq!(read(&folder.path().join(NAME)).unwrap(), PROOFS[..1]);
    }

    #[test]
    fn a_removed_proof_is_forgotten_after_a_restart_too_and_can_be_added_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(NAME);
        let mut state = StateFile::load(folder.path());
        for proof in PROOFS {
            state.add(proof).unwrap();
        }
        state.remove(PROOFS[0]).unwrap();
        assert_eq!(state.proofs(), Proofs::of(&PROOFS[1..]));
        assert_eq!(read(&path).unwrap(), PROOFS[1..]);
        let mut state = StateFile::load(folder.path());
        // An unknown one changes nothing.
        state.remove(PROOFS[0]).unwrap();
        assert_eq!(read(&path).unwrap(), PROOFS[1..]);
        state.add(PROOFS[0]).unwrap();
        assert_eq!(read(&path).unwrap(), [PROOFS[1], PROOFS[0]]);
    }

    #[test]
    fn a_removal_that_cannot_be_written_leaves_no_file_until_it_can() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(NAME);
        let mut state = StateFile::load(folder.path());
        for proof in PROOFS {
            state.add(proof).unwrap();
        }
        let obstacle = obstruct(folder.path());
        state.remove(PROOFS[0]).unwrap();
        assert!(!path.exists());
        assert_eq!(StateFile::load(folder.path()).proofs(), Proofs::default());
        fs::remove_dir(obstacle).unwrap();
        state.retry().unwrap();
        assert_eq!(read(&path).unwrap(), PROOFS[1..]);
    }
}
