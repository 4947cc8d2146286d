//! A campaign: runs an experiment, shows its progress, or reads its results. The file with the results of a
//! shard is JSON, a line for the header and one per unit; those of all shards are joined.

use std::{
    collections::BTreeMap,
    fs::{self, Permissions},
    hash::{DefaultHasher, Hasher as _},
    io::{self, IsTerminal as _, Write as _},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use serde_json::{Value, value::RawValue};

use crate::{
    Result,
    shard::{Experiment, Results, Shard, run_units, thread_count},
};

/// The version of the files.
pub const FORMAT: u32 = 1;

/// The first line of a result file. Files of one campaign differ in `shard` only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// The experiment's name.
    pub campaign: String,
    /// [`FORMAT`].
    pub format: u32,
    /// The version of Singletrack.
    pub version: String,
    /// A hash of the program's file, and of others that decide the results: two builds may
    /// compute other bits.
    pub program: String,
    /// What decides the results.
    pub options: Value,
    /// The number of units of the whole campaign.
    pub units: u64,
    /// The part of the campaign that is in the file.
    pub shard: Shard,
}

/// A line with the result of a unit.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Line<'a> {
    unit: u64,
    /// Kept as it is written: no number is read and printed again.
    #[serde(borrow)]
    result: &'a RawValue,
}

/// The results of one shard, or of a whole campaign.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultFile {
    /// What decided the results.
    pub header: Header,
    /// The JSON text of each unit's result.
    results: BTreeMap<u64, String>,
}

impl Header {
    /// The header for a shard of an experiment that this program runs.
    ///
    /// # Errors
    ///
    /// The options have no JSON, or a file can't be read.
    pub fn of<E: Experiment>(experiment: &E, shard: Shard) -> Result<Self> {
        Ok(Self {
            campaign: E::NAME.to_owned(),
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            program: program(experiment.files())?,
            options: serde_json::to_value(experiment)?,
            units: experiment.units(),
            shard,
        })
    }
}

/// A hash of this program's file and of others.
fn program(files: Vec<PathBuf>) -> Result<String> {
    // The file that runs, also when it has been replaced meanwhile.
    let own = PathBuf::from("/proc/self/exe");
    let mut hasher = DefaultHasher::new();
    for path in [own].into_iter().chain(files) {
        hasher.write(&fs::read(&path).map_err(system_error("read", &path))?);
    }
    Ok(format!("{:016x}", hasher.finish()))
}

impl ResultFile {
    /// Reads a file. It has all units of its shard and no other.
    ///
    /// # Errors
    ///
    /// The file can't be read, is no result file, or is not complete.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).map_err(system_error("read", path))?;
        let invalid = |line: usize, reason: String| {
            format!("{}, line {}: {reason}", path.display(), line + 1)
        };
        let mut lines = text.lines().enumerate();
        let (_, first) = lines
            .next()
            .ok_or_else(|| invalid(0, "the file is empty".to_owned()))?;
        let header: Header = serde_json::from_str(first)
            .map_err(|error| invalid(0, format!("no header of a result file: {error}")))?;
        if header.format != FORMAT {
            let format = header.format;
            let reason =
                format!("the file has format {format}, this program reads format {FORMAT}");
            return Err(invalid(0, reason).into());
        }
        let mut expected = header.shard.units(header.units);
        let mut results = BTreeMap::new();
        for (number, line) in lines {
            let line: Line<'_> = serde_json::from_str(line)
                .map_err(|error| invalid(number, format!("no result of a unit: {error}")))?;
            if expected.next() != Some(line.unit) {
                let (unit, shard) = (line.unit, header.shard);
                let reason = format!("unit {unit} is not the next one of shard {shard}");
                return Err(invalid(number, reason).into());
            }
            results.insert(line.unit, line.result.get().to_owned());
        }
        if let Some(unit) = expected.next() {
            let (path, shard) = (path.display(), header.shard);
            return Err(format!(
                "{path}: unit {unit} of shard {shard} is missing; run this shard again"
            )
            .into());
        }
        Ok(Self { header, results })
    }

    /// The file's text.
    ///
    /// # Errors
    ///
    /// The header has no JSON.
    pub fn text(&self) -> Result<String> {
        let mut text = serde_json::to_string(&self.header)?;
        text.push('\n');
        for (unit, result) in &self.results {
            text += &format!("{{\"unit\":{unit},\"result\":{result}}}\n");
        }
        Ok(text)
    }

    /// Writes the file, as a whole or not at all: a shard that was ended leaves no part.
    ///
    /// # Errors
    ///
    /// The system's error.
    pub fn write(&self, path: &Path) -> Result {
        let text = self.text()?;
        let written = || {
            let mut file = tempfile::Builder::new()
                .prefix(".shard-")
                .permissions(Permissions::from_mode(0o666))
                .tempfile_in(folder(path))?;
            file.write_all(text.as_bytes())?;
            file.persist(path)?;
            Ok(())
        };
        Ok(written().map_err(system_error("write", path))?)
    }
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

fn system_error(what: &str, path: &Path) -> impl Fn(io::Error) -> String {
    move |error| format!("can't {what} {}: {error}", path.display())
}

/// Options of `singletrack merge`.
#[derive(Clone, Debug, Args)]
pub struct MergeArgs {
    /// The files of all shards, in any order.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Where to write the joined file [default: standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Joins the files of all shards of a campaign to the file that one process writes.
///
/// # Errors
///
/// A file can't be read, units are missing or there twice, or the files are of different campaigns.
pub fn merge_files(paths: &[PathBuf]) -> Result<ResultFile> {
    let files = paths.iter().map(|path| ResultFile::read(path));
    let files = files.collect::<Result<Vec<_>>>()?;
    let first = files.first().ok_or("give the files of the shards")?;
    let whole = Header {
        shard: Shard::WHOLE,
        ..first.header.clone()
    };
    let of = first.header.shard.of();
    let mut results = BTreeMap::new();
    // Which file has which units: a double is named with both files.
    let mut shards: Vec<(&PathBuf, Shard)> = Vec::new();
    for (path, file) in paths.iter().zip(files) {
        same_campaign(&paths[0], &whole, path, &file.header)?;
        for (unit, result) in file.results {
            if results.insert(unit, result).is_some() {
                let with_unit =
                    |(_, shard): &&(_, Shard)| Shard::with_unit(unit, shard.of()) == *shard;
                let earlier = shards.iter().find(with_unit).map_or(path, |(path, _)| path);
                let [earlier, path] = [earlier.display(), path.display()];
                return Err(format!(
                    "unit {unit} is in {earlier} and in {path}: give each shard once"
                )
                .into());
            }
        }
        shards.push((path, file.header.shard));
    }
    let units = whole.units;
    let count = units - results.len() as u64;
    if let Some(unit) = (0..units).find(|unit| !results.contains_key(unit)) {
        let shard = Shard::with_unit(unit, of);
        return Err(format!(
            "{count} of {units} units are missing, the first is {unit}: give also shard {shard}"
        )
        .into());
    }
    Ok(ResultFile {
        header: whole,
        results,
    })
}

fn same_campaign(first: &Path, one: &Header, second: &Path, other: &Header) -> Result {
    let values = |header: &Header| {
        [
            ("the campaign", header.campaign.clone()),
            ("the version", header.version.clone()),
            ("the build (a hash of the program)", header.program.clone()),
            ("the options", header.options.to_string()),
            ("the number of units", header.units.to_string()),
        ]
    };
    for ((what, one), (_, other)) in values(one).into_iter().zip(values(other)) {
        if one != other {
            let [first, second] = [first.display(), second.display()];
            return Err(format!(
                "{first} and {second} are of different campaigns: {what} is {one} in the one and \
                 {other} in the other"
            )
            .into());
        }
    }
    Ok(())
}

/// The command `singletrack merge`.
///
/// # Errors
///
/// The files can't be joined, or the result can't be written.
pub fn run_merge(arguments: &MergeArgs) -> Result {
    let merged = merge_files(&arguments.files)?;
    match &arguments.out {
        Some(path) => merged.write(path),
        None => match io::stdout().lock().write_all(merged.text()?.as_bytes()) {
            // The reader of a pipe may close it at any time.
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                Err(format!("can't write to standard output: {error}").into())
            }
            _ => Ok(()),
        },
    }
}

/// A campaign that was run or read.
#[derive(Debug)]
pub struct Campaign<E: Experiment> {
    /// The experiment: that of the files if they were read.
    pub experiment: E,
    /// Which part of it this is.
    pub shard: Shard,
    /// The results.
    pub results: Results<E>,
}

impl<E: Experiment> Campaign<E> {
    /// Runs what the arguments say, or reads the results of `--from`. Writes the result file
    /// of `--json`.
    ///
    /// # Errors
    ///
    /// A unit can't be run, or a file can't be read or written.
    pub fn obtain(experiment: E, arguments: &CampaignArgs) -> Result<Self> {
        if !arguments.from.is_empty() {
            return Self::read(&arguments.from);
        }
        let shard = arguments.shard.unwrap_or(Shard::WHOLE);
        if let Some(path) = &arguments.json {
            // Before hours of work.
            tempfile::tempfile_in(folder(path)).map_err(system_error("write", path))?;
        }
        let units: Vec<u64> = shard.units(experiment.units()).collect();
        let work = |unit| experiment.run(unit);
        let results = run_shown(E::NAME, &units, arguments.threads(), work)?;
        if let Some(path) = &arguments.json {
            let header = Header::of(&experiment, shard)?;
            let texts = results.iter();
            let texts = texts.map(|(unit, result)| Ok((*unit, serde_json::to_string(result)?)));
            let results = texts.collect::<Result<_>>()?;
            ResultFile { header, results }.write(path)?;
        }
        Ok(Self {
            experiment,
            shard,
            results,
        })
    }

    /// Reads the files of all shards of a campaign.
    fn read(paths: &[PathBuf]) -> Result<Self> {
        let file = merge_files(paths)?;
        let other = |reason: String| {
            let path = paths.first().cloned().unwrap_or_default();
            let path = path.display();
            format!("{path}: {reason}; this is a report about {:?}", E::NAME)
        };
        let campaign = &file.header.campaign;
        if campaign != E::NAME {
            return Err(other(format!("it has results of {campaign:?}")).into());
        }
        let experiment = serde_json::from_value(file.header.options.clone());
        let experiment = experiment.map_err(|error| other(format!("its options: {error}")))?;
        let results = file.results.iter();
        let results = results.map(|(unit, text)| Ok((*unit, serde_json::from_str(text)?)));
        let results = results.collect::<Result<_, serde_json::Error>>();
        Ok(Self {
            experiment,
            shard: Shard::WHOLE,
            results: results
                .map_err(|error| other(format!("another version wrote it: {error}")))?,
        })
    }
}

/// Options of a command that runs a campaign.
#[derive(Clone, Debug, Default, Args)]
pub struct CampaignArgs {
    /// Run part K of N only, K from 1 to N: on N machines, or as a job array
    #[arg(long, value_name = "K/N")]
    pub shard: Option<Shard>,

    /// Write the results to this file, for `singletrack merge` and --from
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,

    /// Run nothing: report the results in the files of all shards, or in the merged one.
    /// The options that decide the results are those of the files.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["shard", "json"])]
    pub from: Vec<PathBuf>,

    /// Number of threads; does not affect the results [default: one per core]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

impl CampaignArgs {
    /// The number of threads to use.
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(thread_count).max(1)
    }
}

/// Interval of the lines in a log.
const LINE_INTERVAL: Duration = Duration::from_secs(60);

/// Runs units as [`run_units`] does, with a bar on a terminal, and a line a minute in a log, as the job
/// of a cluster has it.
///
/// # Errors
///
/// The first error of `work`.
pub fn run_shown<R: Send, E: Send>(
    name: &str,
    units: &[u64],
    threads: usize,
    work: impl Fn(u64) -> Result<R, E> + Sync,
) -> Result<Vec<(u64, R)>, E> {
    let bar = ProgressBar::new(units.len() as u64);
    let template = "{bar:30} {pos}/{len}, {per_sec}, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    let is_log = !io::stderr().is_terminal();
    let next_line = Mutex::new(Instant::now() + LINE_INTERVAL);
    let results = run_units(units, threads, work, || {
        bar.inc(1);
        let mut next = next_line.lock().unwrap_or_else(PoisonError::into_inner);
        if is_log && Instant::now() >= *next {
            *next += LINE_INTERVAL;
            let (done, all, seconds) = (bar.position(), units.len(), bar.elapsed().as_secs_f64());
            let line = format!("{name}: {done} of {all} after {seconds:.0} s");
            // Standard error may be closed.
            let _ = writeln!(io::stderr().lock(), "{line}");
        }
    });
    bar.finish_and_clear();
    results
}
