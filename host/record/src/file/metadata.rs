//! The metadata of a record in its file.

use std::{borrow::Cow, collections::BTreeMap, path::Path};

use mcap::{Attachment, records::Metadata};

use super::RecordError;
use crate::{ClockMapping, Meta, RECORD_VERSION};

/// Name of the metadata in the file.
pub(crate) const METADATA_NAME: &str = "singletrack";
/// Name of the attachment in the file.
pub(crate) const CONFIGURATION_NAME: &str = "configuration.toml";

const SOFTWARE_PREFIX: &str = "software.";

impl Meta {
    pub(crate) fn to_metadata(&self) -> Metadata {
        let mut metadata = BTreeMap::from([
            ("record_version".to_owned(), RECORD_VERSION.to_string()),
            (
                "protocol_version".to_owned(),
                self.protocol_version.to_string(),
            ),
            (
                "start_monotonic_ns".to_owned(),
                self.start.monotonic_ns.to_string(),
            ),
            ("start_wall_ns".to_owned(), self.start.wall_ns.to_string()),
        ]);
        if let Some(seed) = self.seed {
            metadata.insert("seed".to_owned(), seed.to_string());
        }
        for (component, version) in &self.software {
            metadata.insert(format!("{SOFTWARE_PREFIX}{component}"), version.clone());
        }
        Metadata {
            name: METADATA_NAME.to_owned(),
            metadata,
        }
    }

    pub(crate) fn to_attachment(&self) -> Attachment<'_> {
        Attachment {
            log_time: self.start.wall_ns,
            create_time: self.start.wall_ns,
            name: CONFIGURATION_NAME.to_owned(),
            media_type: "application/toml".to_owned(),
            data: Cow::Borrowed(self.configuration.as_bytes()),
        }
    }

    pub(crate) fn from_parts(
        path: &Path,
        metadata: &Metadata,
        configuration: &[u8],
    ) -> Result<Self, RecordError> {
        let number = |key| number(path, metadata, key);
        let protocol_version = number("protocol_version")?;
        Ok(Self {
            configuration: std::str::from_utf8(configuration)
                .map_err(|_| RecordError::Metadata {
                    path: path.to_owned(),
                    key: CONFIGURATION_NAME,
                    value: String::from_utf8_lossy(configuration).into_owned(),
                    expected: "UTF-8",
                })?
                .to_owned(),
            software: metadata
                .metadata
                .iter()
                .filter_map(|(key, version)| {
                    let component = key.strip_prefix(SOFTWARE_PREFIX)?;
                    Some((component.to_owned(), version.clone()))
                })
                .collect(),
            protocol_version: u16::try_from(protocol_version).map_err(|_| {
                RecordError::Metadata {
                    path: path.to_owned(),
                    key: "protocol_version",
                    value: protocol_version.to_string(),
                    expected: "a number up to 65535",
                }
            })?,
            seed: match metadata.metadata.get("seed") {
                Some(_) => Some(number("seed")?),
                None => None,
            },
            start: ClockMapping {
                monotonic_ns: number("start_monotonic_ns")?,
                wall_ns: number("start_wall_ns")?,
            },
        })
    }
}

/// Refuses records of another version.
pub(crate) fn check_version(path: &Path, metadata: &Metadata) -> Result<(), RecordError> {
    let found = number(path, metadata, "record_version")?;
    if found == u64::from(RECORD_VERSION) {
        return Ok(());
    }
    Err(RecordError::OtherVersion {
        path: path.to_owned(),
        found: u32::try_from(found).unwrap_or(u32::MAX),
        known: RECORD_VERSION,
    })
}

fn number(path: &Path, metadata: &Metadata, key: &'static str) -> Result<u64, RecordError> {
    let value = metadata.metadata.get(key).map_or("", String::as_str);
    value.parse().map_err(|_| RecordError::Metadata {
        path: path.to_owned(),
        key,
        value: value.to_owned(),
        expected: "a number",
    })
}
