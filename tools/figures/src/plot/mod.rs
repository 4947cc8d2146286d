//! `singletrack plot`: the figures of a drive, from its record alone.

mod animation;
pub mod drive;
mod figures;
mod read;
mod report;
mod sample;
mod summary;

use std::{
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};

pub use animation::ANIMATION;
pub use figures::FigureKind;
pub use read::{PlotError, Record};
pub use sample::TruthSample;

use crate::{
    figure::Figure,
    output::{make_folder, write},
};
use drive::Drive;

/// Options of `singletrack plot`.
#[derive(Clone, Debug, Args)]
pub struct PlotArgs {
    /// Records (*.mcap, or *.mcap.part if one is unfinished or truncated), the oldest first.
    #[arg(required = true, value_name = "RECORD")]
    pub records: Vec<PathBuf>,

    /// Folder for the pictures [default: beside the record, named after it].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Only these figures [default: all].
    #[arg(
        long = "figure",
        value_enum,
        value_name = "NAME",
        value_delimiter = ','
    )]
    pub figures: Vec<FigureKind>,

    /// The drive from above, played back at its own speed: animation.svg, which needs no script
    /// [with --figure or --format: beside the figures, else alone].
    #[arg(long)]
    pub animate: bool,

    /// Files to write [default: all; with --figure, svg].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub format: Vec<PlotFormat>,

    /// Which drive of the records, from 1 [default: the last that follows a configured reference,
    /// which those of the calibration don't, or else the last].
    #[arg(long, value_name = "N")]
    pub drive: Option<usize>,

    /// Draw nothing; list the drives with their numbers.
    #[arg(long, conflicts_with_all = ["drive", "figures", "animate", "format", "out"])]
    pub list: bool,
}

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PlotFormat {
    /// A file for each figure, in the size of a paper's column.
    Svg,
    /// The same for the screen, twice as large and light or dark as the browser: `screen/*.svg`.
    Screen,
    /// `report.html`: all figures and the summary, to look around in.
    Html,
}

/// What was written, and what was not.
#[derive(Clone, Debug, Default)]
pub struct Plotted {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Figures that the drive lacks something for.
    pub missing: Vec<(FigureKind, &'static str)>,
}

/// Plots a record. Prints the names of the files on standard output, and notes on
/// standard error.
///
/// # Errors
///
/// A record without a drive, or a file that can't be written.
pub fn run(args: &PlotArgs) -> Result<(), PlotError> {
    let mut records = Vec::new();
    for path in &args.records {
        let record = Record::read(path)?;
        for note in &record.notes {
            eprintln!("singletrack: {}: {note}", record.path.display());
        }
        records.push(record);
    }
    if args.list {
        return list(&records);
    }
    let (record, number) = choose(&records, args.drive)?;
    let (number, drive) = record.choose(Some(number))?;
    let out = args.out.clone().unwrap_or_else(|| beside(&record.path));
    let figures = if args.figures.is_empty() {
        FigureKind::of(drive).collect()
    } else {
        args.figures.clone()
    };
    let formats = match (args.format.is_empty(), args.figures.is_empty()) {
        (false, _) => &args.format[..],
        (true, true) if args.animate => &[],
        (true, true) => &[PlotFormat::Svg, PlotFormat::Html],
        (true, false) => &[PlotFormat::Svg],
    };
    let mut plotted = Plotted::default();
    if formats.contains(&PlotFormat::Svg) {
        plotted = write_figures(drive, &figures, &out)?;
    }
    if formats.contains(&PlotFormat::Screen) {
        let screen = write_each(drive, &figures, &out.join("screen"), Figure::to_screen_svg)?;
        plotted.files.extend(screen.files);
        plotted.missing = screen.missing;
    }
    if args.animate {
        plotted.files.push(write_animation(record, drive, &out)?);
    }
    if formats.contains(&PlotFormat::Html) {
        plotted
            .files
            .push(write_report(record, number, drive, &out)?);
    }
    for (kind, why) in &plotted.missing {
        eprintln!("singletrack: no figure {}: {why}", kind.name());
    }
    let mut stdout = io::stdout().lock();
    for file in &plotted.files {
        if writeln!(stdout, "{}", file.display()).is_err() {
            // The reader of a pipe may close it at any time.
            break;
        }
    }
    Ok(())
}

/// All drives, each with its record and its number in that, from 1.
fn drives(records: &[Record]) -> impl DoubleEndedIterator<Item = (&Record, usize)> {
    records.iter().flat_map(|record| {
        let count = record.recording.drives.len();
        (1..=count).map(move |number| (record, number))
    })
}

/// The drive with this number of all of them, from 1, or the operator's last one: its record, and its
/// number there.
fn choose(records: &[Record], wanted: Option<usize>) -> Result<(&Record, usize), PlotError> {
    let all: Vec<_> = drives(records).collect();
    let count = all.len();
    let operators = || {
        all.iter()
            .rposition(|(record, number)| record.is_operators(*number))
    };
    let chosen = match wanted {
        Some(wanted) => wanted.checked_sub(1).filter(|index| *index < count),
        None => operators().or(count.checked_sub(1)),
    };
    let path = || records.last().map(|last| last.path.clone());
    let Some(index) = chosen else {
        // Of records without a drive, the last says what it has instead.
        if let Some(last) = records.last().filter(|_| count == 0) {
            last.choose(None)?;
        }
        return Err(PlotError::UnknownDrive {
            path: path().unwrap_or_default(),
            wanted: wanted.unwrap_or_default(),
            count,
        });
    };
    if count > 1 {
        let (record, number) = all[index];
        let (_, drive) = record.choose(Some(number))?;
        eprintln!(
            "singletrack: drive {} of {count}, {:.1} s; choose another with --drive, or see them with \
             --list",
            index + 1,
            drive.duration()
        );
    }
    Ok(all[index])
}

/// Prints a line for each drive.
fn list(records: &[Record]) -> Result<(), PlotError> {
    let mut stdout = io::stdout().lock();
    for (index, (record, number)) in drives(records).enumerate() {
        let (_, drive) = record.choose(Some(number))?;
        let begun = summary::begun(record, drive).unwrap_or_else(|| "virtual time".to_owned());
        let reference = record.reference(drive).unwrap_or_else(|| "?".to_owned());
        let line = format!(
            "{:>4}  {begun:<23}  {:>6.1} s  {reference:<15}  {}  {}",
            index + 1,
            drive.duration(),
            summary::ended(record, drive),
            record.path.display()
        );
        if writeln!(stdout, "{line}").is_err() {
            // The reader of a pipe may close it at any time.
            break;
        }
    }
    Ok(())
}

impl Record {
    /// The kind of the reference that a drive was configured with.
    fn reference(&self, drive: &Drive) -> Option<String> {
        let configuration: toml::Table = self.configuration(drive)?.parse().ok()?;
        let kind = configuration.get("reference")?.get("kind")?.as_str()?;
        Some(kind.to_owned())
    }

    /// Whether the drive with this number, from 1, follows a configured reference: those of the
    /// procedures, and of programs, get theirs from outside.
    fn is_operators(&self, number: usize) -> bool {
        let drive = self.recording.drives.get(number - 1);
        drive.is_some_and(|drive| self.reference(drive).is_some_and(|kind| kind != "external"))
    }

    /// The drive with this number, from 1, or the longest, with its number.
    ///
    /// # Errors
    ///
    /// When there is none.
    pub fn choose(&self, number: Option<usize>) -> Result<(usize, &Drive), PlotError> {
        let recording = &self.recording;
        let count = recording.drives.len();
        let Some(longest) = recording.longest() else {
            let why = match recording.changes.last() {
                None => "it has no ticks".to_owned(),
                Some(last) => format!(
                    "in {} ticks the car was never driven; the last mode was {}{}",
                    recording.ticks,
                    last.mode,
                    summary::because(last.reason)
                ),
            };
            return Err(PlotError::NoDrive {
                path: self.path.clone(),
                why,
            });
        };
        let wanted = number.unwrap_or(longest);
        let drive = wanted
            .checked_sub(1)
            .and_then(|index| recording.drives.get(index));
        drive
            .map(|drive| (wanted, drive))
            .ok_or_else(|| PlotError::UnknownDrive {
                path: self.path.clone(),
                wanted,
                count,
            })
    }
}

/// Writes a file for each figure of a drive into `folder`.
///
/// # Errors
///
/// When one can't be written.
pub fn write_figures(
    drive: &Drive,
    figures: &[FigureKind],
    folder: &Path,
) -> Result<Plotted, PlotError> {
    write_each(drive, figures, folder, Figure::to_svg)
}

fn write_each(
    drive: &Drive,
    figures: &[FigureKind],
    folder: &Path,
    svg: fn(&Figure) -> String,
) -> Result<Plotted, PlotError> {
    make_folder(folder)?;
    let mut plotted = Plotted::default();
    for kind in figures {
        match kind.draw(drive) {
            Ok(figure) => {
                let path = folder.join(kind.file_name());
                write(&path, &svg(&figure))?;
                plotted.files.push(path);
            }
            Err(why) => plotted.missing.push((*kind, why)),
        }
    }
    Ok(plotted)
}

/// Writes the animation of a drive into `folder`. Returns its path.
///
/// # Errors
///
/// When the record lacks something for it, or it can't be written.
pub fn write_animation(
    record: &Record,
    drive: &Drive,
    folder: &Path,
) -> Result<PathBuf, PlotError> {
    let configuration = record.configuration(drive).unwrap_or_default();
    let picture =
        animation::animation(drive, configuration).map_err(|why| PlotError::NoAnimation {
            path: record.path.clone(),
            why,
        })?;
    make_folder(folder)?;
    let path = folder.join(ANIMATION);
    write(&path, &picture)?;
    Ok(path)
}

/// The name of the report's file.
pub const REPORT: &str = "report.html";

/// The style sheet of every report.
pub const STYLE: &str = include_str!("report/style.css");

/// Writes the report of a drive, which has this number from 1, into `folder`.
/// Returns its path.
///
/// # Errors
///
/// When it can't be written.
pub fn write_report(
    record: &Record,
    number: usize,
    drive: &Drive,
    folder: &Path,
) -> Result<PathBuf, PlotError> {
    make_folder(folder)?;
    let path = folder.join(REPORT);
    write(&path, &report::report(record, number, drive))?;
    Ok(path)
}

/// The folder of a record's figures: `drives/one.mcap` has `drives/one`.
fn beside(record: &Path) -> PathBuf {
    let name = record
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    let name = name.unwrap_or_default();
    let stem = name.strip_suffix(".part").unwrap_or(&name);
    match stem.strip_suffix(".mcap") {
        Some(stem) if !stem.is_empty() => record.with_file_name(stem),
        _ => record.with_file_name(format!("{name}-figures")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_named_after_the_record() {
        for (record, folder) in [
            ("drives/one.mcap", "drives/one"),
            ("one.mcap.part", "one"),
            ("odd", "odd-figures"),
            (".mcap", ".mcap-figures"),
        ] {
            assert_eq!(beside(Path::new(record)), Path::new(folder));
        }
    }
}
