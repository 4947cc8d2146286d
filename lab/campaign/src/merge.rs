//! Joins the files of shards.

use std::{
    collections::BTreeMap,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use clap::Args;

use crate::{
    Result,
    file::{Header, ResultFile},
    shard::Shard,
};

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
