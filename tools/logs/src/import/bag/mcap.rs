//! Bags in MCAP files.

use std::{
    collections::{HashMap, hash_map::Entry},
    fs::File,
    io::Read as _,
    path::Path,
};

use mcap::{
    McapError,
    records::op,
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

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
        let mut fields = Fields(data);
        let short = || damaged(McapError::UnexpectedEof);
        match opcode {
            op::SCHEMA => {
                let (id, schema) = fields.schema().ok_or_else(short)?;
                schemas.insert(id, schema);
            }
            op::CHANNEL => {
                let (id, schema, [topic, encoding]) = fields.channel().ok_or_else(short)?;
                let schema: Option<&[String; 3]> = schemas.get(&schema);
                let topic = Topic {
                    name: &topic,
                    kind: schema.map_or("", |[name, ..]| name),
                    encoding: &encoding,
                    definition: schema.map(|[_, language, text]| (&**language, &**text)),
                };
                if let Entry::Vacant(new) = channels.entry(id) {
                    new.insert(messages.topic(&topic)?);
                }
            }
            op::MESSAGE => {
                let (channel, receive_ns) = fields.message().ok_or_else(short)?;
                let unknown = || damaged(McapError::UnknownChannel(0, channel));
                if let Some(id) = channels.get(&channel).ok_or_else(unknown)? {
                    messages.message(*id, receive_ns, fields.0)?;
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

/// The rest of a record. [`mcap::parse_record`] reserves as much memory as a text claims to need.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    /// Identifier; name, language and text of a schema.
    fn schema(&mut self) -> Option<(u16, [String; 3])> {
        let id = u16::from_le_bytes(self.number()?);
        Some((id, [self.text()?, self.text()?, self.text()?]))
    }

    /// Identifier and schema; topic and encoding of a channel.
    fn channel(&mut self) -> Option<(u16, u16, [String; 2])> {
        let [id, schema] = [self.number()?, self.number()?].map(u16::from_le_bytes);
        Some((id, schema, [self.text()?, self.text()?]))
    }

    /// Channel and time of reception of a message, before its contents.
    fn message(&mut self) -> Option<(u16, u64)> {
        let channel = u16::from_le_bytes(self.number()?);
        let _sequence: [u8; 4] = self.number()?;
        let [receive_ns, _publish_ns] = [self.number()?, self.number()?].map(u64::from_le_bytes);
        Some((channel, receive_ns))
    }

    fn number<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (number, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*number)
    }

    fn text(&mut self) -> Option<String> {
        let length = u32::from_le_bytes(self.number()?);
        let (text, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(String::from_utf8_lossy(text).into_owned())
    }
}
