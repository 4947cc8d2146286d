//! The files of a demo, and the figures of its board.

use std::{
    fs::{File, TryLockError},
    io,
    path::{Path, PathBuf},
};

use serde::Serialize;
use singletrack_core::config::Config;
use singletrack_figures::{
    output::{WriteError, make_folder, write},
    plot::{ANIMATION, FigureKind, REPORT},
};
use singletrack_sim::{ImageSize, Installation, SimulatedBoard};
use tempfile::TempDir;

use super::DemoArgs;
use crate::Result;

/// The files of a demo; those of its one car are named `DEMO`.
pub(super) const DEMO: &str = "demo";
pub(super) const RECORD: &str = "demo.mcap";
pub(super) const CONFIGURATION: &str = "demo.toml";
pub(super) const SIMULATION: &str = "simulation.toml";
pub(super) const SUMMARY: &str = "summary.json";
/// The most cars of a demo.
pub(super) const MAX_CARS: usize = 20;

/// The record of a car with this name.
pub(super) fn record_of(args: &DemoArgs, name: &str) -> PathBuf {
    args.out.join(format!("{name}.mcap"))
}

/// Writes the configuration of the daemon of a car with this name.
pub(super) fn write_configuration(args: &DemoArgs, name: &str, config: &Config) -> Result<()> {
    let path = args.out.join(format!("{name}.toml"));
    Ok(write(&path, &config.to_toml()?)?)
}

/// A folder.
pub(super) const FIGURES: &str = "figures";

/// Makes the folder of a demo its own until the result is dropped; removes what an earlier one left
/// there.
///
/// # Errors
///
/// It holds something else, or another demo writes to it.
pub(super) fn prepare(folder: &Path) -> Result<File> {
    make_folder(folder)?;
    let failed = || WriteError::of(folder);
    let own = File::open(folder).map_err(failed())?;
    match own.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let folder = folder.display();
            return Err(
                format!("another demo writes to {folder}: give another folder with --out").into(),
            );
        }
        locked => locked.map_err(|error| failed()(error.into()))?,
    }
    let known = files();
    for entry in std::fs::read_dir(folder).map_err(failed())? {
        let name = entry.map_err(failed())?.file_name();
        if name != FIGURES && !known.iter().any(|file| file.as_os_str() == name) {
            return Err(format!(
                "{} holds {}, which no demo has written: give another folder with --out",
                folder.display(),
                name.display()
            )
            .into());
        }
    }
    clear(folder)?;
    Ok(own)
}

/// A folder for sockets and ports, which is removed when the result is dropped.
pub(super) fn private() -> Result<TempDir, String> {
    let folder = tempfile::Builder::new().prefix("singletrack-").tempdir();
    folder.map_err(|error| not_made(&error))
}

/// A temporary folder can't be made.
pub(super) fn not_made(error: &io::Error) -> String {
    format!("can't make a temporary folder: {error}")
}

/// Removes what a demo has written.
pub(super) fn clear(folder: &Path) -> Result<(), WriteError> {
    let figures = FigureKind::ALL.map(|kind| Path::new(FIGURES).join(kind.file_name()));
    for file in files().into_iter().chain(figures) {
        match std::fs::remove_file(folder.join(file)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(WriteError::of(folder)(error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// The files of a demo, besides the figures.
fn files() -> Vec<PathBuf> {
    let cars = (1..=MAX_CARS).map(|number| format!("car{number}.mcap"));
    let records = cars.chain([RECORD.to_owned()]).map(PathBuf::from);
    let of_records = records.flat_map(|it| {
        [
            singletrack_record::part_path(&it),
            it.with_extension("toml"),
            it,
        ]
    });
    let others = [SIMULATION, SUMMARY, REPORT, ANIMATION].map(PathBuf::from);
    others.into_iter().chain(of_records).collect()
}

/// The UNO image's use of its processor, from power-on to the end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct BoardFigures {
    /// Use of the 32,256 B beside the bootloader.
    pub(super) flash_bytes: u64,
    /// Variables and the deepest stack, of 2,048 B.
    pub(super) sram_bytes: u64,
    /// Time not asleep.
    pub(super) cpu_percent: f64,
    /// The longest interrupt, in cycles of 62.5 ns.
    pub(super) isr_max_cycles: u32,
    /// The largest deviation of a pulse from 20 ms after the one before.
    pub(super) pulse_jitter_us: f64,
}

impl BoardFigures {
    /// None for a board that is not a UNO.
    pub(super) fn of(board: &mut SimulatedBoard) -> Result<Option<Self>, String> {
        if let Some(failure) = board.failure() {
            return Err(format!("the board: {failure}"));
        }
        let (Some(figures), Some(pulse_jitter_us)) = (board.figures(), board.pulse_jitter_us())
        else {
            return Ok(None);
        };
        let size = Installation::find()
            .and_then(|installation| ImageSize::read(&installation.image))
            .map_err(|error| format!("the board: {error}"))?;
        let asleep = figures.cycles_asleep as f64 / figures.cycles.max(1) as f64;
        let longest = figures.interrupts.iter().map(|one| one.most_cycles).max();
        Ok(Some(Self {
            flash_bytes: size.flash_bytes,
            sram_bytes: size.static_bytes + u64::from(figures.stack_bytes),
            cpu_percent: 100.0 * (1.0 - asleep),
            isr_max_cycles: longest.unwrap_or(0),
            pulse_jitter_us,
        }))
    }
}
