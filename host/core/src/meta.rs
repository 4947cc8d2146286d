//! What a record says of itself.

use std::collections::BTreeMap;

use singletrack_record::{ClockMapping, Meta};

use crate::config::Config;

/// The name of this software in a record.
const SOFTWARE: &str = "singletrackd";

/// What a record says of itself when it is made with this configuration, by the
/// software at hand.
///
/// # Errors
///
/// A path that is not UTF-8.
pub fn record_meta(
    config: &Config,
    seed: Option<u64>,
    start: ClockMapping,
) -> Result<Meta, toml::ser::Error> {
    Ok(Meta {
        configuration: config.to_toml()?,
        software: BTreeMap::from([(SOFTWARE.to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        protocol_version: singletrack_protocol::VERSION,
        seed,
        start,
    })
}
