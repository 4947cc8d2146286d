//! `singletrack certify`: the certificate of the safety filter, for a configuration.

use std::{fs, path::PathBuf};

use clap::Args;
use singletrack_core::{Config, certificate::certificate};

use crate::Result;

/// Options of `singletrack certify`.
#[derive(Clone, Debug, Args)]
pub struct CertifyArgs {
    /// The car's configuration, as the daemon takes it.
    pub config: PathBuf,

    /// Where the certificate goes: the file of `safety_filter.certificate`.
    #[arg(
        long,
        value_name = "FILE.json",
        default_value = "filter-certificate.json"
    )]
    pub out: PathBuf,
}

/// Writes the certificate.
///
/// # Errors
///
/// The configuration or the file, with what to do.
pub fn run(args: &CertifyArgs) -> Result {
    let text = certificate(&Config::read(&args.config)?)?;
    let path = args.out.display();
    Ok(fs::write(&args.out, text).map_err(|error| format!("can't write {path}: {error}"))?)
}
