//! Making a complete file of a record that a killed recorder left behind, or
//! that was damaged since.

mod scan;

use std::{
    collections::HashMap,
    fmt,
    fs::{File, TryLockError},
    io::Read,
    path::Path,
    time::Duration,
};

use mcap::{
    Attachment, McapError,
    records::{MessageHeader, Metadata, Record, op},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use scan::{Found, MAX_LENGTH, Scan};

use crate::{
    Channel, RecordError, Topic,
    container::{
        Container, LIBRARY, LIBRARY_NAME, PROFILE, failure, is_data_part, parse_record, with_suffix,
    },
    meta::{CONFIGURATION_NAME, METADATA_NAME},
};

/// What was saved of a record, and what was not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovery {
    /// Messages saved, on all channels.
    pub messages: u64,
    /// Entries among them: messages that a [`crate::Reader`] reads.
    pub entries: u64,
    /// Earliest and latest log time of the messages saved, in ns since 1970.
    pub span_ns: Option<(u64, u64)>,
    /// Length of the new file.
    pub bytes: u64,
    /// Whether the record had its proper end.
    pub complete: bool,
    /// Places within the record that are damaged.
    pub damaged_places: u64,
    /// Bytes that could not be used there.
    pub damaged_bytes: u64,
    /// Bytes at the end that are not a whole part of the record.
    pub cut_bytes: u64,
    /// Messages on channels whose description is lost.
    pub nameless: u64,
    /// Whether it says under which circumstances it was made: without that, other
    /// tools open it and a [`crate::Reader`] does not.
    pub has_metadata: bool,
    /// Whether it has the configuration that it was made with: the same is true.
    pub has_configuration: bool,
    /// Messages that are not there, by the numbers of those around them.
    pub missing: u64,
}

impl Recovery {
    /// From the first to the last message saved.
    #[must_use]
    pub fn duration(&self) -> Duration {
        self.span_ns.map_or(Duration::ZERO, |(first, last)| {
            Duration::from_nanos(last.saturating_sub(first))
        })
    }

    /// What the new file says of how it came about.
    fn to_metadata(&self) -> Metadata {
        let told = [
            ("complete", u64::from(self.complete)),
            ("damaged_places", self.damaged_places),
            ("damaged_bytes", self.damaged_bytes),
            ("cut_bytes", self.cut_bytes),
            ("messages_without_topic", self.nameless),
            ("messages_missing", self.missing),
        ];
        Metadata {
            name: "singletrack_recovery".to_owned(),
            metadata: told
                .map(|(key, value)| (key.to_owned(), value.to_string()))
                .into(),
        }
    }

    /// Whether nothing was missing.
    #[must_use]
    pub const fn nothing_lost(&self) -> bool {
        self.complete
            && self.damaged_places == 0
            && self.nameless == 0
            && self.missing == 0
            && self.has_metadata
            && self.has_configuration
    }
}

impl fmt::Display for Recovery {
    /// What was saved on one line, and what was lost on the next ones.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "saved {} entries ({} messages) of {:.2} s",
            self.entries,
            self.messages,
            self.duration().as_secs_f64()
        )?;
        if self.nothing_lost() {
            return formatter.write_str("\nlost nothing");
        }
        if self.damaged_places > 0 {
            write!(
                formatter,
                "\nlost {} bytes in {} damaged places",
                self.damaged_bytes, self.damaged_places
            )?;
        }
        if self.nameless > 0 {
            write!(
                formatter,
                "\nlost {} messages, because nothing tells their topic",
                self.nameless
            )?;
        }
        if !(self.has_metadata && self.has_configuration) {
            formatter.write_str(
                "\nlost what the record says of itself: other tools open it, singletrack does not",
            )?;
        }
        if self.missing > 0 {
            write!(
                formatter,
                "\nlost {} messages between others, by their numbers",
                self.missing
            )?;
        }
        if !self.complete {
            write!(
                formatter,
                "\nlost the end: {} bytes are not whole, and up to a second before the recorder stopped may be missing",
                self.cut_bytes
            )?;
        }
        Ok(())
    }
}

/// Writes what can be read of the record at `input` to a new one at `output`,
/// with the index that tools expect. The old one stays as it is. Every message
/// comes over as it is, also of another version of records; nothing of a damaged
/// chunk is believed. The new file says in its metadata what it lacks. `progress` is told
/// how many bytes of how many are done.
///
/// # Errors
///
/// When one of the files cannot be read or written, `input` is still being written,
/// `output` exists, or nothing was recorded. No new file is left then.
pub fn recover(
    input: &Path,
    output: &Path,
    mut progress: impl FnMut(u64, u64),
) -> Result<Recovery, RecordError> {
    let file = File::open(input).map_err(failure("open", input))?;
    // A recorder holds on to its file for as long as it writes.
    if matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)) {
        return Err(RecordError::Busy(input.to_owned()));
    }
    let mut scan = Scan::new(file).map_err(failure("read", input))?;
    let library = check_head(input, &mut scan)?;
    let mut salvage = Salvage {
        container: Container::create(output, with_suffix(output, ".recovering"))?,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        describes: library == LIBRARY,
        recovery: Recovery::default(),
    };
    let result = salvage.all(input, &mut scan, &mut progress);
    let Salvage {
        mut container,
        mut recovery,
        ..
    } = salvage;
    if let Err(error) = result {
        container.discard()?;
        return Err(error);
    }
    if recovery.messages == 0 {
        container.discard()?;
        return Err(RecordError::Empty {
            path: input.to_owned(),
            bytes: scan.length(),
        });
    }
    let told = recovery.to_metadata();
    container.write(|writer| writer.write_metadata(&told))?;
    recovery.bytes = container.finish()?;
    Ok(recovery)
}

/// Refuses what is no record, by the words that a reader would use. Tells who wrote it.
fn check_head(input: &Path, scan: &mut Scan) -> Result<String, RecordError> {
    let empty = |length| RecordError::Empty {
        path: input.to_owned(),
        bytes: length,
    };
    let length = scan.length();
    if !scan.magic().map_err(failure("read", input))? {
        return Err(if length < mcap::MAGIC.len() as u64 {
            empty(length)
        } else {
            RecordError::NotMcap(input.to_owned())
        });
    }
    match scan.next().map_err(failure("read", input))? {
        Found::Record { opcode, content } => match parse_record(opcode, content) {
            Ok(Record::Header(header))
                if header.profile == PROFILE && header.library.starts_with(LIBRARY_NAME) =>
            {
                Ok(header.library)
            }
            Ok(Record::Header(header)) => Err(RecordError::NotOurs {
                path: input.to_owned(),
                profile: header.profile,
                library: header.library,
            }),
            _ => Err(RecordError::NotMcap(input.to_owned())),
        },
        Found::Nothing | Found::End => Err(empty(length)),
    }
}

/// A new file, and what has gone into it.
struct Salvage {
    container: Container,
    /// New numbers by old ones: a file may describe things twice.
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, NewChannel>,
    /// Whether this version wrote it, and knows what the channels were.
    describes: bool,
    recovery: Recovery,
}

#[derive(Clone, Copy)]
struct NewChannel {
    id: u16,
    /// Whether a reader of records reads it.
    entries: bool,
    /// Number of its next message; none before the first. They count from 0.
    next: Option<u32>,
}

/// Why a part of the old file is not taken over.
enum Refused {
    Damaged,
    Failed(RecordError),
}

impl From<McapError> for Refused {
    fn from(_: McapError) -> Self {
        Self::Damaged
    }
}

impl From<RecordError> for Refused {
    fn from(error: RecordError) -> Self {
        Self::Failed(error)
    }
}

impl Salvage {
    fn all(
        &mut self,
        input: &Path,
        scan: &mut Scan,
        progress: &mut impl FnMut(u64, u64),
    ) -> Result<(), RecordError> {
        let length = scan.length();
        // Damage may be followed by something whole; at the end it is a cut.
        let mut trouble = 0;
        loop {
            let from = scan.at();
            progress(from, length);
            let refused = match scan.next().map_err(failure("read", input))? {
                Found::End => break,
                Found::Nothing => true,
                Found::Record { opcode, content } => match self.part(opcode, content) {
                    Ok(End::No) => false,
                    Ok(End::Yes) => {
                        self.recovery.complete = true;
                        false
                    }
                    Err(Refused::Failed(error)) => return Err(error),
                    Err(Refused::Damaged) => true,
                },
            };
            if refused {
                scan.resume(from).map_err(failure("read", input))?;
                trouble += scan.at() - from;
            } else if trouble > 0 {
                self.recovery.damaged_places += 1;
                self.recovery.damaged_bytes += trouble;
                trouble = 0;
            }
            if self.recovery.complete {
                break;
            }
        }
        self.recovery.cut_bytes = trouble;
        progress(length, length);
        Ok(())
    }

    /// Takes over one part of the file.
    fn part(&mut self, opcode: u8, content: &[u8]) -> Result<End, Refused> {
        if !is_data_part(opcode, content) {
            return Err(Refused::Damaged);
        }
        match opcode {
            op::CHUNK => self.chunk(content)?,
            op::DATA_END => return Ok(End::Yes),
            _ => self.record(&parse_record(opcode, content)?)?,
        }
        Ok(End::No)
    }

    /// Takes over what is in a chunk, once its checksum has been found right.
    fn chunk(&mut self, content: &[u8]) -> Result<(), Refused> {
        let length = (content.len() as u64).to_le_bytes();
        let mut bytes = (&[op::CHUNK][..]).chain(&length[..]).chain(content);
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_LENGTH);
        let mut reader = LinearReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let buffer = reader.insert(wanted.clamp(1, content.len().max(1)));
                    let length = bytes.read(buffer).map_err(McapError::from)?;
                    reader.notify_read(length);
                }
                LinearReadEvent::Record { opcode, data } => {
                    self.record(&parse_record(opcode, data)?)?;
                }
            }
        }
        // What was together stays together.
        self.container.end_chunk()?;
        Ok(())
    }

    fn record(&mut self, record: &Record<'_>) -> Result<(), Refused> {
        match record {
            Record::Metadata(metadata) => {
                self.recovery.has_metadata |= metadata.name == METADATA_NAME;
                self.container
                    .write(|writer| writer.write_metadata(metadata))?;
            }
            Record::Attachment { header, data, .. } => {
                self.recovery.has_configuration |= header.name == CONFIGURATION_NAME;
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name.clone(),
                    media_type: header.media_type.clone(),
                    data: data.clone(),
                };
                self.container.write(|writer| writer.attach(&attachment))?;
            }
            Record::Schema { header, data } => {
                let id = self
                    .container
                    .write(|writer| writer.add_schema(&header.name, &header.encoding, data))?;
                self.schemas.insert(header.id, id);
            }
            Record::Channel(channel) => {
                let schema = match channel.schema_id {
                    0 => 0,
                    id => *self.schemas.get(&id).ok_or(Refused::Damaged)?,
                };
                let id = self.container.write(|writer| {
                    writer.add_channel(
                        schema,
                        &channel.topic,
                        &channel.message_encoding,
                        &channel.metadata,
                    )
                })?;
                let entries = is_entry(&channel.topic);
                let new = NewChannel {
                    id,
                    entries,
                    next: None,
                };
                // Described again, it goes on.
                self.channels.entry(channel.id).or_insert(new).id = id;
            }
            Record::Message { header, data } => self.message(header, data)?,
            // The new file gets its own.
            _ => {}
        }
        Ok(())
    }

    /// What the channels were is lost: it is what it always is.
    fn describe(&mut self) -> Result<(), RecordError> {
        let ids = self.container.describe()?;
        for (channel, id) in Channel::all().zip(ids) {
            let new = NewChannel {
                id,
                entries: is_entry(channel.topic()),
                next: None,
            };
            self.channels.insert(id, new);
        }
        Ok(())
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), RecordError> {
        if self.channels.is_empty() && self.describes {
            self.describe()?;
        }
        let Some(channel) = self.channels.get_mut(&header.channel_id) else {
            self.recovery.nameless += 1;
            return Ok(());
        };
        let ahead = header.sequence.wrapping_sub(channel.next.unwrap_or(0));
        // What goes back was numbered by somebody else.
        if i32::try_from(ahead).is_ok() {
            self.recovery.missing += u64::from(ahead);
        }
        channel.next = Some(header.sequence.wrapping_add(1));
        let header = MessageHeader {
            channel_id: channel.id,
            ..*header
        };
        self.container
            .write(|writer| writer.write_to_known_channel(&header, data))?;
        let recovery = &mut self.recovery;
        recovery.messages += 1;
        recovery.entries += u64::from(channel.entries);
        let time = header.log_time;
        recovery.span_ns = Some(match recovery.span_ns {
            Some((first, last)) => (first.min(time), last.max(time)),
            None => (time, time),
        });
        Ok(())
    }
}

/// Whether a reader of records reads what is on the topic.
fn is_entry(topic: &str) -> bool {
    Topic::ALL.into_iter().any(|known| known.channel() == topic)
}

/// Whether a part was the last one with data.
enum End {
    No,
    Yes,
}
