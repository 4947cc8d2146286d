//! `singletrack recover`: repairs an unfinished or damaged record.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::{Result, operator::control::print, progress::progress_bar};

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

/// Runs the command.
///
/// # Errors
///
/// When the record can't be read, holds nothing, or the new one can't be
/// written.
pub fn run(args: &RecoverArgs) -> Result<()> {
    let output = match &args.out {
        Some(output) => output.clone(),
        None => default_output(&args.record),
    };
    let bar = progress_bar(0, "{bar:30} {percent:>3} %  {bytes} read");
    let result = singletrack_record::recover(&args.record, &output, |done, of| {
        bar.set_length(of);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    print(&format!("{}: {}", output.display(), result?))
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
