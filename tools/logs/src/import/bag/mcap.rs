//! Bags in MCAP files.

use std::{
    collections::{HashMap, hash_map::Entry},
    fs::File,
    io::Read as _,
    path::Path,
};

use mcap::{
    McapError,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use singletrack_record::parse_record;

use super::{
    messages::{Messages, Topic},
    unreadable,
};
use crate::import::log::ImportError;

/// The length of a record that every file may have, in bytes.
const LONGEST: usize = 64 << 20;

/// Reads a file.
pub(super) fn read(path: &Path, messages: &mut Messages) -> Result<(), ImportError> {
    let failed = ImportError::read(path);
    let damaged = |error: McapError| unreadable(path, fix(&error));
    let mut file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    // A record that claims to be longer is an error, before there is memory for it. Those of a
    // compressed chunk may be longer than the file.
    let options = LinearReaderOptions::default()
        .with_record_length_limit(usize::try_from(length).unwrap_or(usize::MAX).max(LONGEST))
        .with_validate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut schemas = HashMap::new();
    let mut channels = HashMap::new();
    while let Some(event) = reader.next_event() {
        let (opcode, data) = match event.map_err(damaged)? {
            LinearReadEvent::Record { opcode, data } => (opcode, data),
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need)).map_err(failed)?;
                reader.notify_read(read);
                continue;
            }
        };
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            continue;
        }
        match parse_record(opcode, data).map_err(damaged)? {
            Record::Schema { header, data } => {
                let text = String::from_utf8_lossy(&data).into_owned();
                schemas.insert(header.id, (header, text));
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id);
                let topic = Topic {
                    name: &channel.topic,
                    kind: schema.map_or("", |(header, _)| &header.name),
                    encoding: &channel.message_encoding,
                    definition: schema.map(|(header, text)| (&*header.encoding, &**text)),
                };
                if let Entry::Vacant(new) = channels.entry(channel.id) {
                    new.insert(messages.topic(&topic)?);
                }
            }
            Record::Message { header, data } => {
                let channel = header.channel_id;
                let unknown = || damaged(McapError::UnknownChannel(0, channel));
                if let Some(id) = channels.get(&channel).ok_or_else(unknown)? {
                    messages.message(*id, header.log_time, &data)?;
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// What is wrong with a file, and what to do.
fn fix(error: &McapError) -> String {
    let fix = match error {
        McapError::UnsupportedCompression(_) => {
            "only zstd is read: `mcap compress --compression zstd` and `ros2 bag convert` make such a file"
        }
        McapError::BadMagic => {
            "it is no MCAP file, or its end is missing: `mcap recover` repairs it"
        }
        _ => "it is damaged: `mcap recover` saves what can be read",
    };
    format!("{error}: {fix}")
}
