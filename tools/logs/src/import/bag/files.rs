//! The files of a bag.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use super::unreadable;
use crate::import::log::ImportError;

/// The list of files in the folder of a bag.
const METADATA: &str = "metadata.yaml";

/// How messages are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Storage {
    Mcap,
    Sqlite,
}

/// Whether a path is that of a bag, by its name: a folder, or a file of one.
pub(in crate::import) fn is_bag(path: &Path) -> bool {
    let is_file = ["mcap", "db3", "bag", "zstd", "zip"]
        .iter()
        .any(|extension| path.extension().is_some_and(|own| own == *extension));
    is_file || path.is_dir()
}

/// Refuses a file that is none of a bag, whatever the map.
pub(in crate::import) fn check(path: &Path) -> Result<(), ImportError> {
    match path.is_dir() {
        true => Ok(()),
        false => storage(path).map(drop),
    }
}

/// The files of a bag, in their order.
pub(super) fn files(path: &Path) -> Result<Vec<(PathBuf, Storage)>, ImportError> {
    if !path.is_dir() {
        return Ok(vec![(path.to_owned(), storage(path)?)]);
    }
    let metadata = path.join(METADATA);
    let text = match fs::read_to_string(&metadata) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let files = readable_files(path).into_iter();
            let files: String = files.map(|file| format!(", {file}")).collect();
            let why = "it has no metadata.yaml: write it with `ros2 bag reindex`, or import one of its files";
            return Err(unreadable(path, format!("{why}{files}")));
        }
        Err(error) => return Err(ImportError::read(&metadata)(error)),
    };
    let names = names(&text).map_err(|why| unreadable(path, why))?;
    let file = |name: &String| {
        // Old bags have the name of the folder before that of the file.
        let name = Path::new(name).file_name().unwrap_or_default();
        let file = path.join(name);
        let storage = storage(&file)?;
        Ok((file, storage))
    };
    names.iter().map(file).collect()
}

/// The names of files in the list of a bag. It is YAML that a program writes, with one key or element
/// a line.
fn names(text: &str) -> Result<Vec<String>, String> {
    let unquoted = |word: &str| word.trim().trim_matches(['"', '\'']).to_owned();
    let mut names = Vec::new();
    let mut is_list = false;
    for line in text.lines().map(str::trim) {
        match line.strip_prefix("- ") {
            Some(name) if is_list => names.push(unquoted(name)),
            Some(_) => {}
            None => is_list = line == "relative_file_paths:",
        }
        if let Some(mode) = line.strip_prefix("compression_mode:")
            && !matches!(unquoted(mode).as_str(), "" | "NONE" | "none")
        {
            return Err(format!(
                "it is compressed ({} mode): convert it with `ros2 bag convert` to one without \
                 compression",
                unquoted(mode)
            ));
        }
    }
    match names.is_empty() {
        true => Err(
            "its metadata.yaml has no list relative_file_paths: write it with `ros2 bag reindex`"
                .to_owned(),
        ),
        false => Ok(names),
    }
}

fn storage(file: &Path) -> Result<Storage, ImportError> {
    let extension = file.extension().map(|own| own.to_string_lossy());
    let why = match extension.as_deref() {
        Some("mcap") => return Ok(Storage::Mcap),
        Some("db3") => return Ok(Storage::Sqlite),
        Some("zstd") => {
            "it is compressed: decompress it with `zstd -d`, and import the file that it makes"
        }
        Some("zip") => {
            "it is an archive: unpack it with `unzip`, and import the bag's folder in it"
        }
        Some("bag") => "it is a bag of ROS 1: convert it with `rosbags-convert`",
        _ => "its name ends neither in .mcap nor in .db3",
    };
    Err(unreadable(file, why))
}

/// The files in a folder that can be imported, in the order of their names.
fn readable_files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let files = entries.filter(|entry| storage(&entry.path()).is_ok());
    let mut names: Vec<_> = files
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_of_files_is_read_with_and_without_quotes() {
        let text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - \
                    bag/a_0.db3\n    - \"a 1.db3\"\n  topics_with_message_count:\n    - topic_metadata:\n  \
                    compression_format: \"\"\n  compression_mode: \"\"\n";
        let expected = ["bag/a_0.db3", "a 1.db3"].map(str::to_owned);
        assert_eq!(names(text), Ok(expected.to_vec()));
        let compressed = text.replace("compression_mode: \"\"", "compression_mode: FILE");
        let error = names(&compressed).unwrap_err();
        assert!(error.contains("compressed (FILE mode)"), "{error}");
        // The file that `rosbags-convert` writes.
        let text = "rosbag2_bagfile_information:\n  compression_mode: ''\n  files:\n  - duration:\n      \
                    nanoseconds: 2\n    path: log.db3\n  relative_file_paths:\n  - log.db3\n  ros_distro: \
                    rosbags\n";
        assert_eq!(names(text), Ok(vec!["log.db3".to_owned()]));
        assert!(names("rosbag2_bagfile_information:\n").is_err());
    }
}
