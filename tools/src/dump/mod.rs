//! The telemetry dump: a record, or what the daemon sees now, as a table, lines
//! of JSON, or CSV.

mod error;
mod format;
mod source;

use std::{
    io::{self, IsTerminal, Write},
    path::PathBuf,
};

use clap::{Args, ValueEnum};
use singletrack_record::{Ending, Topic};
use singletrackd::config::SocketSection;

pub use error::DumpError;

use format::Printer;
use source::Live;

/// What `singletrack dump` is asked.
#[derive(Args, Clone, Debug)]
pub struct DumpArgs {
    /// A record (*.mcap, or *.mcap.part while or after it was cut short), or
    /// `live` for the running daemon.
    pub source: PathBuf,

    /// What to print: tick, telemetry, status, pose, log or drops.
    #[arg(long, default_value = "telemetry")]
    pub topic: Topic,

    /// How to print it [default: table on a terminal, csv elsewhere].
    #[arg(long, value_enum)]
    pub format: Option<Format>,

    /// Which fields, such as `index,estimate.yaw_rad` [default: all; in a table,
    /// those that matter most].
    #[arg(long, value_delimiter = ',')]
    pub fields: Vec<String>,

    /// Wait for more at the end of a record that is being written.
    #[arg(long)]
    pub follow: bool,

    /// Where the daemon listens, for `live`.
    #[arg(long, default_value_os_t = SocketSection::default().path)]
    pub socket: PathBuf,
}

/// How entries are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Columns for a person; quantities to six digits.
    Table,
    /// One object a line, every digit.
    Json,
    /// One row an entry, every digit.
    Csv,
}

/// Prints to standard output. Whoever reads that may stop at any time.
///
/// # Errors
///
/// When the source cannot be read, or a field does not exist.
pub fn run(args: &DumpArgs) -> Result<(), DumpError> {
    let stdout = io::stdout();
    let format = args.format.unwrap_or(if stdout.is_terminal() {
        Format::Table
    } else {
        Format::Csv
    });
    let printed = print(args, format, stdout.lock());
    match printed {
        Err(DumpError::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

fn print(args: &DumpArgs, format: Format, output: impl Write) -> Result<(), DumpError> {
    let live = args.source.as_os_str() == "live";
    let mut printer = Printer::new(output, format, args.topic, &args.fields)?;
    if live {
        let mut live = Live::connect(&args.socket, args.topic)?;
        printer.begin()?;
        printer.flush()?;
        while let Some((line, shown)) = live.next()? {
            printer.print_line(line, &shown)?;
            printer.flush()?;
        }
        return Ok(());
    }
    let mut reader = source::open(&args.source, args.topic, args.follow)?;
    printer.begin()?;
    for entry in reader.by_ref() {
        match entry {
            Ok(entry) => printer.print(&entry)?,
            Err(error) => {
                // What was read before the damage has been asked for.
                printer.flush()?;
                return Err(error.into());
            }
        }
        if args.follow {
            printer.flush()?;
        }
    }
    printer.flush()?;
    if let Some(ending @ Ending::Unfinished { .. }) = reader.ending() {
        eprintln!("singletrack: {}: {ending}", args.source.display());
    }
    Ok(())
}
