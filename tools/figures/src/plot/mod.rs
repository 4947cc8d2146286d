//! `singletrack plot`: the figures of a drive, from its record alone.

mod animation;
pub mod drive;
mod figures;
mod read;
mod report;
mod summary;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

pub use animation::ANIMATION;
pub use drive::TruthSample;
pub use figures::FigureKind;
pub use read::{PlotError, Record};
pub use summary::because;

use crate::{
    figure::Figure,
    output::{WriteError, print, write_into},
};
use drive::{Drive, Recording};

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
    /// SVG for the screen, twice as large and light or dark as the browser: `screen/*.svg`.
    Screen,
    /// `report.html`: all figures and the summary, to look around in.
    Html,
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
        list(&records);
        return Ok(());
    }
    let (record, number, drive) = choose(&records, args.drive)?;
    let out = args.out.clone().unwrap_or_else(|| beside(&record.path));
    let figures = match args.figures.is_empty() {
        true => FigureKind::of(drive).collect(),
        false => args.figures.clone(),
    };
    let formats = match (args.format.is_empty(), args.figures.is_empty()) {
        (false, _) => &args.format[..],
        (true, true) if args.animate => &[],
        (true, true) => &[PlotFormat::Svg, PlotFormat::Html],
        (true, false) => &[PlotFormat::Svg],
    };
    let mut files = Vec::new();
    if formats.iter().any(|format| *format != PlotFormat::Html) {
        let (figures, missing) = draw(drive, figures);
        if formats.contains(&PlotFormat::Svg) {
            files.extend(write_figures(&figures, &out, Figure::to_svg)?);
        }
        if formats.contains(&PlotFormat::Screen) {
            let folder = out.join("screen");
            files.extend(write_figures(&figures, &folder, Figure::to_screen_svg)?);
        }
        for (kind, why) in missing {
            eprintln!("singletrack: no figure {}: {why}", kind.name());
        }
    }
    if args.animate {
        files.push(write_animation(record, drive, &out)?);
    }
    if formats.contains(&PlotFormat::Html) {
        files.push(write_report(record, number, drive, &out)?);
    }
    let lines = files.iter().map(|file| format!("{}\n", file.display()));
    // They are there whether or not anyone reads their names.
    let _ = print(&lines.collect::<String>());
    Ok(())
}

/// Figures of a drive, and why those are missing that the drive lacks something for.
type Drawn = (Vec<(FigureKind, Figure)>, Vec<(FigureKind, &'static str)>);

/// Draws figures of a drive.
pub fn draw(drive: &Drive, kinds: impl IntoIterator<Item = FigureKind>) -> Drawn {
    let (mut figures, mut missing) = (Vec::new(), Vec::new());
    for kind in kinds {
        match kind.draw(drive) {
            Ok(figure) => figures.push((kind, figure)),
            Err(why) => missing.push((kind, why)),
        }
    }
    (figures, missing)
}

/// A drive, with its record and its number in that, from 1.
type Numbered<'a> = (&'a Record, usize, &'a Drive);

fn drives<'a>(records: &'a [Record]) -> Vec<Numbered<'a>> {
    let of = |record: &'a Record| {
        (1..)
            .zip(&record.recording.drives)
            .map(move |(number, drive)| (record, number, drive))
    };
    records.iter().flat_map(of).collect()
}

/// The drive with this number of all of them, from 1, or the operator's last one.
fn choose(records: &[Record], wanted: Option<usize>) -> Result<Numbered<'_>, PlotError> {
    let all = drives(records);
    let count = all.len();
    let operators = || {
        all.iter()
            .rposition(|(record, _, drive)| record.is_operators(drive))
    };
    let index = match wanted {
        Some(wanted) => wanted.checked_sub(1),
        None => operators().or(count.checked_sub(1)),
    };
    let Some((index, chosen)) = index.and_then(|index| Some((index, *all.get(index)?))) else {
        // Of records without a drive, the last says what it has instead.
        let last = records.last().ok_or(PlotError::NoRecord)?;
        return Err(match count {
            0 => last.no_drive(),
            count => last.no_such_drive(wanted.unwrap_or_default(), count),
        });
    };
    if count > 1 {
        let (.., drive) = chosen;
        eprintln!(
            "singletrack: drive {} of {count}, {:.1} s; choose another with --drive, or see them with \
             --list",
            index + 1,
            drive.duration()
        );
    }
    Ok(chosen)
}

/// Prints a line for each drive.
fn list(records: &[Record]) {
    let mut lines = String::new();
    for (index, (record, _, drive)) in drives(records).into_iter().enumerate() {
        let begun = summary::begun(record, drive).unwrap_or_else(|| "virtual time".to_owned());
        let reference = record.reference(drive).unwrap_or_else(|| "?".to_owned());
        lines += &format!(
            "{:>4}  {begun:<23}  {:>6.1} s  {reference:<15}  {}  {}\n",
            index + 1,
            drive.duration(),
            summary::ended(record, drive),
            record.path.display()
        );
    }
    let _ = print(&lines);
}

impl Record {
    /// The kind of the reference that a drive was configured with.
    fn reference(&self, drive: &Drive) -> Option<String> {
        let settings = self.settings(drive);
        let kind = settings.get("reference")?.get("kind")?.as_str()?;
        Some(kind.to_owned())
    }

    /// Whether a drive follows a configured reference: those of the procedures, and of programs, get
    /// theirs from outside.
    fn is_operators(&self, drive: &Drive) -> bool {
        self.reference(drive).is_some_and(|kind| kind != "external")
    }

    fn no_drive(&self) -> PlotError {
        let Recording { changes, ticks, .. } = &self.recording;
        let why = match changes.last() {
            None => "it has no ticks".to_owned(),
            Some(last) => format!(
                "in {ticks} ticks the car was never driven; the last mode was {}{}",
                last.mode,
                because(last.reason)
            ),
        };
        self.missing(format!(
            "there is no drive in this record: {why}; singletrack dump --topic tick shows what there is"
        ))
    }

    fn no_such_drive(&self, wanted: usize, count: usize) -> PlotError {
        self.missing(format!(
            "there is no drive {wanted}: choose --drive from 1 to {count}"
        ))
    }

    fn missing(&self, why: String) -> PlotError {
        let path = self.path.clone();
        PlotError::Missing { path, why }
    }

    /// The drive with this number, from 1, or the longest, with its number.
    ///
    /// # Errors
    ///
    /// When there is none.
    pub fn choose(&self, number: Option<usize>) -> Result<(usize, &Drive), PlotError> {
        let drives = &self.recording.drives;
        let longest = self.recording.longest().ok_or_else(|| self.no_drive())?;
        let wanted = number.unwrap_or(longest);
        let drive = wanted.checked_sub(1).and_then(|index| drives.get(index));
        let drive = drive.ok_or_else(|| self.no_such_drive(wanted, drives.len()))?;
        Ok((wanted, drive))
    }
}

/// Writes a file for each figure into `folder`, as `svg` makes it of a figure. Returns their paths.
///
/// # Errors
///
/// When one can't be written.
pub fn write_figures(
    figures: &[(FigureKind, Figure)],
    folder: &Path,
    svg: fn(&Figure) -> String,
) -> Result<Vec<PathBuf>, WriteError> {
    let write =
        |(kind, figure): &(FigureKind, Figure)| write_into(folder, &kind.file_name(), &svg(figure));
    figures.iter().map(write).collect()
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
    let picture = animation::animation(drive, &record.settings(drive))
        .map_err(|why| record.missing(format!("no animation: {why}")))?;
    Ok(write_into(folder, ANIMATION, &picture)?)
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
) -> Result<PathBuf, WriteError> {
    write_into(folder, REPORT, &report::report(record, number, drive))
}

/// The folder of a record's figures: `drives/one.mcap` has `drives/one`.
fn beside(record: &Path) -> PathBuf {
    let name = record.file_name().unwrap_or_default().to_string_lossy();
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
