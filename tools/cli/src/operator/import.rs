//! `singletrack import`: makes a record of the log of another program.

use std::path::PathBuf;

use clap::Args;
use singletrack_logs::import::import;

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

/// Runs the command.
///
/// # Errors
///
/// When map or log can't be read or the record can't be written. Then no record is left.
pub fn run(args: &ImportArgs) -> Result<()> {
    let bar = progress_bar(0, "{bar:30} {percent:>3} %  {pos} ticks");
    let result = import(&args.log, &args.map, &args.out, |done, of| {
        bar.set_length(of);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let summary = result?;
    print(&format!("{}: {summary}", args.out.display()))
}
