//! A JSON file in `state.directory`, which is replaced as a whole: a loss of power leaves the old
//! one or the new one.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Longer than every valid file, in bytes.
const LONGEST: u64 = 65_536;

/// A file whose content has the key `version`.
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
