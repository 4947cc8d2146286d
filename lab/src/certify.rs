//! `singletrack certify`: the certificate of the safety filter, for a configuration.

use std::{fs, io, path::PathBuf};

use clap::Args;
use singletrack_core::{Config, ConfigError, certificate::certificate};

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

/// Why there is no certificate.
#[derive(Debug, thiserror::Error)]
pub enum CertifyError {
    /// The configuration is not one, or has none.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The file can't be written.
    #[error("can't write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Writes the certificate.
///
/// # Errors
///
/// [`CertifyError`].
pub fn run(args: &CertifyArgs) -> Result<(), CertifyError> {
    let text = certificate(&Config::read(&args.config)?)?;
    fs::write(&args.out, text).map_err(|source| CertifyError::Write {
        path: args.out.clone(),
        source,
    })
}
