//! Joins the files of shards.

use std::{
    collections::BTreeMap,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use clap::Args;

use crate::{
    file::{FileError, Header, ResultFile},
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

/// Why files can't be joined.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A file can't be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// Two files are of different campaigns.
    #[error(
        "{} and {} are of different campaigns: {what} is {first} in the one and {second} in the other",
        paths[0].display(),
        paths[1].display()
    )]
    Mixture {
        /// The two files.
        paths: [PathBuf; 2],
        /// What differs.
        what: &'static str,
        /// In the first file.
        first: String,
        /// In the second file.
        second: String,
    },
    /// A unit is in two files.
    #[error("unit {unit} is in {} and in {}: give each shard once", paths[0].display(), paths[1].display())]
    Double {
        /// The unit.
        unit: u64,
        /// The two files.
        paths: [PathBuf; 2],
    },
    /// Units are missing.
    #[error("{count} of {units} units are missing, the first is {unit}: give also shard {shard}")]
    Gap {
        /// How many are missing.
        count: u64,
        /// How many there should be.
        units: u64,
        /// The first missing unit.
        unit: u64,
        /// The shard that has it, with as many shards as the first file says.
        shard: Shard,
    },
    /// There is no file.
    #[error("give the files of the shards")]
    Nothing,
    /// Standard output can't be written.
    #[error("can't write to standard output: {0}")]
    Output(io::Error),
}

/// Reads the files of all shards and joins them.
///
/// # Errors
///
/// A file can't be read, or the files are not those of one campaign.
pub fn merge_files(paths: &[PathBuf]) -> Result<ResultFile, MergeError> {
    let mut files = Vec::with_capacity(paths.len());
    for path in paths {
        files.push((path.clone(), ResultFile::read(path)?));
    }
    merge(files)
}

/// Joins the files of all shards of a campaign to the file that one process writes.
///
/// # Errors
///
/// Units are missing or there twice, or the files are of different campaigns.
pub fn merge(files: Vec<(PathBuf, ResultFile)>) -> Result<ResultFile, MergeError> {
    let mut merged: Option<(PathBuf, Header)> = None;
    let mut results: BTreeMap<u64, String> = BTreeMap::new();
    // Which file has which units: a double is named with both files.
    let mut shards: Vec<(PathBuf, Shard)> = Vec::new();
    for (path, file) in files {
        let ResultFile {
            header,
            results: units,
        } = file;
        match &merged {
            None => merged = Some((path.clone(), header.clone())),
            Some((first, other)) => same_campaign(first, other, &path, &header)?,
        }
        for (unit, result) in units {
            if results.insert(unit, result).is_some() {
                let with_unit =
                    |(_, shard): &&(PathBuf, Shard)| Shard::with_unit(unit, shard.of()) == *shard;
                let earlier = shards.iter().find(with_unit);
                let earlier = earlier.map_or_else(|| path.clone(), |(path, _)| path.clone());
                return Err(MergeError::Double {
                    unit,
                    paths: [earlier, path],
                });
            }
        }
        shards.push((path, header.shard));
    }
    let (_, header) = merged.ok_or(MergeError::Nothing)?;
    let units = header.units;
    let count = units - results.len() as u64;
    if let Some(unit) = (0..units).find(|unit| !results.contains_key(unit)) {
        return Err(MergeError::Gap {
            count,
            units,
            unit,
            shard: Shard::with_unit(unit, header.shard.of()),
        });
    }
    let header = Header {
        shard: Shard::WHOLE,
        ..header
    };
    Ok(ResultFile { header, results })
}

fn same_campaign(
    first: &Path,
    one: &Header,
    second: &Path,
    other: &Header,
) -> Result<(), MergeError> {
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
            return Err(MergeError::Mixture {
                paths: [first.to_owned(), second.to_owned()],
                what,
                first: one,
                second: other,
            });
        }
    }
    Ok(())
}

/// The command `singletrack merge`.
///
/// # Errors
///
/// The files can't be joined, or the result can't be written.
pub fn run_merge(arguments: &MergeArgs) -> Result<(), MergeError> {
    let merged = merge_files(&arguments.files)?;
    match &arguments.out {
        Some(path) => Ok(merged.write(path)?),
        None => match io::stdout().lock().write_all(merged.text()?.as_bytes()) {
            // The reader of a pipe may close it at any time.
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                Err(MergeError::Output(error))
            }
            _ => Ok(()),
        },
    }
}
