//! The folder of a demo.

use std::{
    io,
    path::{Path, PathBuf},
};

use singletrack_figures::plot::{FigureKind, REPORT};

use super::error::DemoError;

/// The files of a demo.
pub(super) const RECORD: &str = "demo.mcap";
pub(super) const CONFIGURATION: &str = "demo.toml";
pub(super) const SIMULATION: &str = "simulation.toml";
pub(super) const SUMMARY: &str = "summary.json";
/// A folder.
pub(super) const FIGURES: &str = "figures";

/// Makes the folder; removes what an earlier demo left there.
pub(super) fn prepare(folder: &Path) -> Result<(), DemoError> {
    let error = |source| DemoError::Write {
        path: folder.to_owned(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(error)?;
    let unfinished = singletrack_record::part_path(Path::new(RECORD));
    let files = [RECORD, CONFIGURATION, SIMULATION, SUMMARY, REPORT].map(PathBuf::from);
    let figures = FigureKind::ALL.map(|kind| Path::new(FIGURES).join(kind.file_name()));
    for file in files.into_iter().chain([unfinished]).chain(figures) {
        match std::fs::remove_file(folder.join(file)) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => return Err(error(source)),
            _ => {}
        }
    }
    Ok(())
}

/// Writes a file.
pub(super) fn write(path: &Path, text: &str) -> Result<(), DemoError> {
    std::fs::write(path, text).map_err(|source| DemoError::Write {
        path: path.to_owned(),
        source,
    })
}
