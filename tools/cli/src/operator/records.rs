//! `singletrack import|recover`: makes a record of the log of another program, or of an unfinished or
//! damaged record.

use std::path::{Path, PathBuf};

use clap::Args;
use singletrack_logs::import;

use crate::{Result, operator::control::print, progress::progress_bar};

/// Options of `singletrack import`.
#[derive(Args)]
pub struct ImportArgs {
    /// The log: CSV files on one clock, each with the names of its columns in its first line; or a bag of
    /// ROS 2, as its folder or as one MCAP or sqlite file (.mcap, .db3).
    #[arg(required = true)]
    log: Vec<PathBuf>,
    /// What the columns or topics are, such as tools/real/dart-map.toml (CSV) or
    /// tools/real/f1tenth-vicon.toml (bag).
    #[arg(long, value_name = "MAP.toml")]
    map: PathBuf,
    /// Where the record goes. A file that is there is kept, and the command refused.
    #[arg(long, value_name = "RECORD.mcap")]
    out: PathBuf,
}

/// Makes a record of a log.
///
/// # Errors
///
/// When map or log can't be read or the record can't be written. Then no record is left.
pub fn import(args: &ImportArgs) -> Result<()> {
    let summary = with_bar("{bar:30} {percent:>3} %  {pos} ticks", |progress| {
        import::import(&args.log, &args.map, &args.out, progress)
    })?;
    print(&format!("{}: {summary}", args.out.display()))
}

/// Works while a bar shows what is done, of how much.
fn with_bar<T>(template: &str, work: impl FnOnce(&mut dyn FnMut(u64, u64)) -> T) -> T {
    let bar = progress_bar(0, template);
    let result = work(&mut |done, of| {
        bar.set_length(of);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    result
}

/// Options of `singletrack recover`.
#[derive(Args)]
pub struct RecoverArgs {
    /// The record, such as NAME.mcap.part. It is not changed.
    record: PathBuf,
    /// Where the repaired record goes [default: NAME.mcap, or NAME.recovered.mcap for a
    /// record that has that name].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Repairs a record.
///
/// # Errors
///
/// When the record can't be read, holds nothing, or the new one can't be
/// written.
pub fn recover(args: &RecoverArgs) -> Result<()> {
    let default = || default_output(&args.record);
    let output = args.out.clone().unwrap_or_else(default);
    let recovered = with_bar("{bar:30} {percent:>3} %  {bytes} read", |progress| {
        singletrack_record::recover(&args.record, &output, progress)
    })?;
    print(&format!("{}: {recovered}", output.display()))
}

/// The name that the record would have got, had it been finished.
fn default_output(record: &Path) -> PathBuf {
    match record.extension() {
        Some(extension) if extension == "part" => record.with_extension(""),
        _ => record.with_extension("recovered.mcap"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recovered_record_gets_the_name_it_was_meant_to_have() {
        let name = |record: &str| default_output(Path::new(record));
        assert_eq!(
            name("a/drive.mcap.part"),
            Path::new("a/drive.mcap").to_owned()
        );
        assert_eq!(
            name("a/drive.mcap"),
            Path::new("a/drive.recovered.mcap").to_owned()
        );
    }
}
