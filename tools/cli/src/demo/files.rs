//! The folder of a demo.

use std::{
    fs::{File, TryLockError},
    io,
    path::{Path, PathBuf},
};

use singletrack_core::config::Config;
use singletrack_figures::plot::{ANIMATION, FigureKind, REPORT};

use super::error::DemoError;

/// The files of a demo.
pub(super) const RECORD: &str = "demo.mcap";
pub(super) const CONFIGURATION: &str = "demo.toml";
pub(super) const SIMULATION: &str = "simulation.toml";
pub(super) const SUMMARY: &str = "summary.json";
/// The most cars of a demo.
pub(super) const MAX_CARS: usize = 20;

/// The record of one of several cars.
pub(super) fn record_of(config: &Config) -> PathBuf {
    PathBuf::from(format!("{}.mcap", config.motion_capture.rigid_body))
}

/// The configuration of one of several cars.
pub(super) fn configuration_of(config: &Config) -> PathBuf {
    PathBuf::from(format!("{}.toml", config.motion_capture.rigid_body))
}

/// A folder.
pub(super) const FIGURES: &str = "figures";

/// Makes the folder of a demo its own until the result is dropped; removes what an earlier one left
/// there.
///
/// # Errors
///
/// It holds something else, or another demo writes to it.
pub(super) fn prepare(folder: &Path) -> Result<File, DemoError> {
    let error = |source| DemoError::Write {
        path: folder.to_owned(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(error)?;
    let own = File::open(folder).map_err(error)?;
    match own.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(DemoError::InUse(folder.to_owned())),
        Err(TryLockError::Error(source)) => return Err(error(source)),
    }
    let known = files();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let name = entry.map_err(error)?.file_name();
        if name != FIGURES && !known.iter().any(|file| file.as_os_str() == name) {
            return Err(DemoError::HoldsOthers {
                folder: folder.to_owned(),
                name: name.to_string_lossy().into_owned(),
            });
        }
    }
    clear(folder)?;
    Ok(own)
}

/// Removes what a demo has written.
pub(super) fn clear(folder: &Path) -> Result<(), DemoError> {
    let figures = FigureKind::ALL.map(|kind| Path::new(FIGURES).join(kind.file_name()));
    for file in files().into_iter().chain(figures) {
        match std::fs::remove_file(folder.join(file)) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                return Err(DemoError::Write {
                    path: folder.to_owned(),
                    source,
                });
            }
            _ => {}
        }
    }
    Ok(())
}

/// The files of a demo, besides the figures.
fn files() -> Vec<PathBuf> {
    let cars = (1..=MAX_CARS).map(|number| format!("car{number}.mcap"));
    let records: Vec<_> = cars.chain([RECORD.to_owned()]).map(PathBuf::from).collect();
    let unfinished = records
        .iter()
        .map(|record| singletrack_record::part_path(record));
    let configurations = records.iter().map(|record| record.with_extension("toml"));
    let files = [SIMULATION, SUMMARY, REPORT, ANIMATION];
    files
        .map(PathBuf::from)
        .into_iter()
        .chain(unfinished)
        .chain(configurations)
        .chain(records.iter().cloned())
        .collect()
}

/// Writes a file.
pub(super) fn write(path: &Path, text: &str) -> Result<(), DemoError> {
    std::fs::write(path, text).map_err(|source| DemoError::Write {
        path: path.to_owned(),
        source,
    })
}
