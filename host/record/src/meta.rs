//! The metadata of a record.

use std::{borrow::Cow, collections::BTreeMap, path::Path};

use mcap::{Attachment, records::Metadata};

use crate::RecordError;

/// The version of records that this crate writes and reads. It must match exactly.
pub const RECORD_VERSION: u32 = 12;

/// Name of the metadata in the file.
pub(crate) const METADATA_NAME: &str = "singletrack";
/// Name of the attachment in the file.
pub(crate) const CONFIGURATION_NAME: &str = "configuration.toml";

const SOFTWARE_PREFIX: &str = "software.";

/// The circumstances under which a record was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Meta {
    /// The configuration used, as TOML.
    pub configuration: String,
    /// Versions by component, such as `singletrackd`.
    pub software: BTreeMap<String, String>,
    /// Version of the protocol between the computers.
    pub protocol_version: u16,
    /// Seed of the simulation, if there was one.
    pub seed: Option<u64>,
    /// The clocks when the record began.
    pub start: ClockMapping,
}

/// The same moment on two clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockMapping {
    /// On the host's monotonic clock, in ns.
    pub monotonic_ns: u64,
    /// On the wall clock, in ns since 1970.
    pub wall_ns: u64,
}

impl ClockMapping {
    /// Of a drive in virtual time, which has no time of day: 2000-01-01.
    pub const VIRTUAL: Self = Self {
        monotonic_ns: 0,
        wall_ns: 946_684_800_000_000_000,
    };

    /// The time of a wall clock that was not set since, at `monotonic_ns`.
    #[must_use]
    pub const fn wall_ns_at(&self, monotonic_ns: u64) -> u64 {
        if monotonic_ns >= self.monotonic_ns {
            self.wall_ns
                .saturating_add(monotonic_ns - self.monotonic_ns)
        } else {
            self.wall_ns
                .saturating_sub(self.monotonic_ns - monotonic_ns)
        }
    }
}

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
