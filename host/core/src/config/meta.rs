//! The metadata of a record.

use std::collections::BTreeMap;

use singletrack_record::{ClockMapping, Meta};

use crate::config::Config;

/// The name of this software in the metadata.
const SOFTWARE: &str = "singletrackd";

/// The name of the controller in the metadata, with its number.
const CONTROLLER: &str = "controller";

/// The metadata of a record with this configuration, seed and clock mapping, for this
/// version of the software.
///
/// # Errors
///
/// The configuration has a path that is not UTF-8.
pub fn record_meta(
    config: &Config,
    seed: Option<u64>,
    start: ClockMapping,
) -> Result<Meta, toml::ser::Error> {
    Ok(Meta {
        configuration: config.to_toml()?,
        software: BTreeMap::from([
            (SOFTWARE.to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            (
                CONTROLLER.to_owned(),
                singletrack_pilot::CONTROLLER.to_string(),
            ),
        ]),
        protocol_version: singletrack_protocol::VERSION,
        seed,
        start,
    })
}
