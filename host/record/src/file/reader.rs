//! Reading of records, finished or not.

use std::{
    collections::HashMap,
    fmt,
    fs::File,
    io::Read,
    mem,
    path::{Path, PathBuf},
};

use mcap::{
    McapError,
    records::{Metadata, Record, op},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use super::{
    RecordError,
    chunk::{Chunk, MAX_PART_LENGTH, is_data_part, parse_record},
    metadata::{CONFIGURATION_NAME, METADATA_NAME, check_version, message_count, span_wall_ns},
    recorder::{PROFILE, failure, part_path},
};
use crate::{Entry, Meta, Topic, Value};

/// Bytes of the length of a list.
const LENGTH: usize = size_of::<u32>();
/// Bytes read from the file at once.
const READ_LENGTH: usize = 64 << 10;

/// Reads a record from start to end.
///
/// The iterator gives entries, for computing. For printing, [`Reader::advance`] goes to
/// the next message and [`Reader::read_values`] or [`Reader::write_json`] reads it, without
/// an [`Entry`] between.
///
/// An unfinished record is read up to its end; [`Reader::ending`] then says so. Unknown
/// channels are skipped. After an error nothing follows.
pub struct Reader {
    path: PathBuf,
    file: Box<dyn Read + Send>,
    linear: LinearReader,
    chunk: Chunk,
    catalogue: Catalogue,
    /// The metadata of the record.
    pub meta: Meta,
    /// Whether the data section has ended and only the summary follows.
    data_ended: bool,
    /// The message that [`Reader::advance`] went to; its content is in the catalogue.
    at: Option<Recorded>,
    /// [`Topic::list_at`] of ticks.
    events_at: Option<usize>,
    bytes: u64,
    entries: u64,
    /// How the record ended; none before the end, and after an error.
    pub ending: Option<Ending>,
    failed: bool,
}

/// A message before its fields are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Its topic.
    pub topic: Topic,
    /// When it reached the host, in ns since 1970 on the wall clock: see
    /// [`crate::ClockMapping`].
    pub wall_ns: u64,
}

/// How a record ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// With its index, complete.
    Finished,
    /// In the middle: the recorder was killed, or the file was truncated.
    Unfinished {
        /// Entries read.
        entries: u64,
        /// Length of the file, in bytes.
        bytes: u64,
    },
}

impl fmt::Display for Ending {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Finished => formatter.write_str("the record is complete"),
            Self::Unfinished { entries, bytes } => write!(
                formatter,
                "the record is unfinished: it stops after {entries} entries ({bytes} bytes); up to a second before the recorder stopped may be missing"
            ),
        }
    }
}

/// The descriptions found in the file so far.
#[derive(Default)]
struct Catalogue {
    header: Option<(String, String)>,
    metadata: Option<Metadata>,
    configuration: Option<Vec<u8>>,
    /// Schema names by id, and whether their text is that of this program.
    schemas: HashMap<u16, (String, bool)>,
    /// Our channels: their topics, by id.
    channels: Vec<Option<Topic>>,
    /// The topics that are read, if not all are.
    topics: Option<Vec<Topic>>,
    /// The last message that was taken.
    content: Vec<u8>,
}

/// One step through the file.
enum Step {
    Nothing,
    /// A message, which is now in [`Catalogue::content`].
    Message(Recorded),
    /// A message of a topic that is not read.
    Skipped,
    End,
    /// The file ended before the end of the record.
    Cut,
}

impl Reader {
    /// Opens a record and reads its metadata. An unfinished record is found by its final
    /// name as well.
    ///
    /// # Errors
    ///
    /// When the file can't be read, is not a record, or is one of another version.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let part = part_path(path);
        // A record gets its final name when it is finished.
        let path = if !path.exists() && part.exists() {
            &part
        } else {
            path
        };
        Self::from_read(File::open(path).map_err(failure("open", path))?, path)
    }

    /// Reads a record that is no file of this computer. Errors name it by `path`.
    ///
    /// # Errors
    ///
    /// When it is not a record, or is one of another version.
    pub fn from_read(file: impl Read + Send + 'static, path: &Path) -> Result<Self, RecordError> {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_PART_LENGTH);
        let mut reader = Self {
            path: path.to_owned(),
            file: Box::new(file),
            linear: LinearReader::new_with_options(options),
            chunk: Chunk::default(),
            catalogue: Catalogue::default(),
            meta: Meta::default(),
            data_ended: false,
            at: None,
            events_at: Topic::Tick.list_at(),
            bytes: 0,
            entries: 0,
            ending: None,
            failed: false,
        };
        reader.meta = reader.read_meta()?;
        Ok(reader)
    }

    /// Yields entries of these topics only; others are not decoded.
    #[must_use]
    pub fn only(mut self, topics: &[Topic]) -> Self {
        self.catalogue.topics = Some(topics.to_vec());
        self
    }

    /// The wall time of the first and the last message of a finished record, in ns since 1970,
    /// without reading up to there; none of an unfinished one, and of one without messages.
    pub fn span_wall_ns(&self) -> Option<[u64; 2]> {
        span_wall_ns(&self.path)
    }

    /// The number of messages of a topic in a finished record, without reading it; none of an
    /// unfinished one.
    pub fn message_count(&self, topic: Topic) -> Option<u64> {
        message_count(&self.path, topic)
    }

    /// Passes the entries to `take`, up to the end or to damage after the first entry.
    /// Returns the damage, if there is any: the entries before it can be used.
    ///
    /// # Errors
    ///
    /// When there is no entry before the damage, or the file can't be read.
    pub fn take_undamaged(
        &mut self,
        mut take: impl FnMut(&Entry),
    ) -> Result<Option<RecordError>, RecordError> {
        let mut any = false;
        for entry in self {
            match entry {
                Ok(entry) => take(&entry),
                Err(error @ RecordError::Damaged { .. }) if any => return Ok(Some(error)),
                Err(error) => return Err(error),
            }
            any = true;
        }
        Ok(None)
    }

    /// Goes to the next message; none at the end of the record, and at the current end of
    /// an unfinished one: see [`Reader::ending`]. An unfinished record may have grown at
    /// the next call.
    ///
    /// # Errors
    ///
    /// When the file is damaged or can't be read. After an error nothing follows.
    pub fn advance(&mut self) -> Result<Option<Recorded>, RecordError> {
        self.at = None;
        if self.failed || self.ending == Some(Ending::Finished) {
            return Ok(None);
        }
        self.ending = None;
        loop {
            match self.step() {
                Ok(Step::Nothing) => {}
                Ok(Step::Skipped) => self.entries += 1,
                Ok(Step::Message(message)) => {
                    self.entries += 1;
                    self.at = Some(message);
                    return Ok(self.at);
                }
                Ok(Step::Cut) => {
                    self.ending = Some(Ending::Unfinished {
                        entries: self.entries,
                        bytes: self.bytes,
                    });
                    return Ok(None);
                }
                Ok(Step::End) => {
                    self.ending = Some(Ending::Finished);
                    return Ok(None);
                }
                Err(error) => {
                    self.failed = true;
                    return Err(error);
                }
            }
        }
    }

    /// Replaces `values` with the fields of the message that [`Reader::advance`] went to,
    /// in the order of [`Topic::fields`]; with nothing before the first.
    ///
    /// # Errors
    ///
    /// When the message is damaged.
    pub fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), RecordError> {
        values.clear();
        let Some(Recorded { topic, .. }) = self.at else {
            return Ok(());
        };
        let events = self.without_events(topic, |content| topic.read_values(content, values))?;
        // The value of a list is its length.
        if let (Some(events), Some(shown)) = (events, values.last_mut()) {
            *shown = Value::Unsigned(events.into());
        }
        Ok(())
    }

    /// Passes the message that [`Reader::advance`] went to to `take`; nothing before the first. A
    /// tick is without its events, which are half of it.
    ///
    /// # Errors
    ///
    /// When the message is damaged.
    pub fn read_entry(&mut self, take: impl FnOnce(&Entry)) -> Result<(), RecordError> {
        let Some(Recorded { topic, .. }) = self.at else {
            return Ok(());
        };
        self.without_events(topic, |content| {
            take(&Entry::decode(topic, content)?);
            Ok(())
        })
        .map(drop)
    }

    /// Reads the message at hand; a tick without its events, which are half of it and need not be
    /// decoded. Returns how many they are.
    fn without_events(
        &mut self,
        topic: Topic,
        read: impl FnOnce(&[u8]) -> Result<(), String>,
    ) -> Result<Option<u32>, RecordError> {
        let events_at = self.events_at.filter(|_| topic == Topic::Tick);
        let head = events_at.and_then(|at| self.catalogue.content.get_mut(..at + LENGTH));
        let mut events = None;
        let read = match head {
            Some(head) => {
                let length = head.last_chunk_mut::<LENGTH>().map(mem::take);
                let read = read(head);
                if let (Some(place), Some(length)) = (head.last_chunk_mut(), length) {
                    *place = length;
                    events = Some(u32::from_le_bytes(length));
                }
                read
            }
            None => read(&self.catalogue.content),
        };
        read.map_err(|reason| self.invalid(topic, &reason))?;
        Ok(events)
    }

    /// Adds the message that [`Reader::advance`] went to to `json`, as
    /// [`Entry::write_json`] does; nothing before the first.
    ///
    /// # Errors
    ///
    /// When the message is damaged.
    pub fn write_json(&mut self, json: &mut String) -> Result<(), RecordError> {
        let Some(Recorded { topic, .. }) = self.at else {
            return Ok(());
        };
        topic
            .write_json(&self.catalogue.content, json)
            .map_err(|reason| self.invalid(topic, &reason))
    }

    /// The error for a damaged message.
    fn invalid(&mut self, topic: Topic, reason: &str) -> RecordError {
        self.failed = true;
        // It is not one of the entries before the damage.
        self.entries = self.entries.saturating_sub(1);
        self.damaged(format_args!("{topic}: {reason}"))
    }

    fn read_meta(&mut self) -> Result<Meta, RecordError> {
        loop {
            match self.step()? {
                Step::Nothing | Step::Skipped => {}
                Step::Cut => {
                    return Err(RecordError::Empty {
                        path: self.path.clone(),
                        bytes: self.bytes,
                    });
                }
                Step::Message(_) | Step::End => return Err(self.not_ours()),
            }
            let known = &self.catalogue;
            let header = known.header.as_ref();
            let is_other = header.is_some_and(|(profile, _)| profile != PROFILE);
            if is_other || (known.metadata.is_none() && !known.schemas.is_empty()) {
                return Err(self.not_ours());
            }
            if let Some(metadata) = &known.metadata {
                check_version(&self.path, metadata)?;
                if let Some(configuration) = &known.configuration {
                    return Meta::from_parts(&self.path, metadata, configuration);
                }
            }
        }
    }

    fn not_ours(&self) -> RecordError {
        let (profile, library) = self.catalogue.header.clone().unwrap_or_default();
        RecordError::NotOurs {
            path: self.path.clone(),
            profile,
            library,
        }
    }

    fn damaged(&self, reason: impl fmt::Display) -> RecordError {
        RecordError::Damaged {
            path: self.path.clone(),
            entries: self.entries,
            bytes: self.bytes,
            reason: reason.to_string(),
        }
    }

    /// Reads the next record of the container.
    fn step(&mut self) -> Result<Step, RecordError> {
        let step = match self.chunk.next() {
            Some(Ok((opcode, data))) => self.catalogue.take(opcode, data),
            Some(Err(error)) => Err(error.into()),
            None => return self.step_outside(),
        };
        step.map_err(|refused| self.refuse(refused))
    }

    /// Reads the next record of the container outside a chunk.
    fn step_outside(&mut self) -> Result<Step, RecordError> {
        let (opcode, data) = match self.linear.next_event() {
            None => return Ok(Step::End),
            Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                let buffer = self.linear.insert(wanted.clamp(1, READ_LENGTH));
                let length = self.file.read(buffer);
                let length = length.map_err(failure("read", &self.path))?;
                self.bytes += length as u64;
                if length == 0 {
                    return Ok(Step::Cut);
                }
                self.linear.notify_read(length);
                return Ok(Step::Nothing);
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => (opcode, data),
            Some(Err(McapError::BadMagic)) if self.catalogue.header.is_none() => {
                return Err(RecordError::NotMcap(self.path.clone()));
            }
            Some(Err(error)) => return Err(self.refuse(error.into())),
        };
        let step = match opcode {
            _ if !self.data_ended && !is_data_part(opcode, data) => Err(Refused::Damage(format!(
                "a part of kind {opcode:#04x} stands where there is none"
            ))),
            op::DATA_END => {
                self.data_ended = true;
                Ok(Step::Nothing)
            }
            // They are many and have nothing new.
            op::MESSAGE_INDEX | op::CHUNK_INDEX => Ok(Step::Nothing),
            op::CHUNK => match self.chunk.open_part(data) {
                Ok(()) => Ok(Step::Nothing),
                Err(error) => Err(error.into()),
            },
            _ => self.catalogue.take(opcode, data),
        };
        step.map_err(|refused| self.refuse(refused))
    }

    fn refuse(&self, refused: Refused) -> RecordError {
        match refused {
            Refused::Damage(reason) => self.damaged(reason),
            Refused::OtherSchema(schema) => RecordError::Invalid(format!(
                "{} has another layout of {schema} than this program: use the singletrack of the \
                 release that wrote it",
                self.path.display()
            )),
        }
    }
}

/// Why a part of the file is refused.
enum Refused {
    Damage(String),
    OtherSchema(String),
}

impl From<McapError> for Refused {
    fn from(error: McapError) -> Self {
        Self::Damage(error.to_string())
    }
}

impl From<String> for Refused {
    fn from(why: String) -> Self {
        Self::Damage(why)
    }
}

/// Length of the head of a message: channel, number, log time and publish time.
const MESSAGE_HEAD_LENGTH: usize = 2 + 4 + 8 + 8;

impl Catalogue {
    /// Takes one record of the container; a message goes to `content`.
    fn take(&mut self, opcode: u8, data: &[u8]) -> Result<Step, Refused> {
        if opcode == op::MESSAGE {
            return self.take_message(data);
        }
        match parse_record(opcode, data)? {
            Record::Header(header) => self.header = Some((header.profile, header.library)),
            Record::Metadata(metadata) if metadata.name == METADATA_NAME => {
                self.metadata = Some(metadata);
            }
            Record::Attachment { header, data, .. } if header.name == CONFIGURATION_NAME => {
                self.configuration = Some(data.into_owned());
            }
            Record::Schema { header, data } => {
                // The summary repeats them.
                self.schemas.entry(header.id).or_insert_with(|| {
                    let same = header.encoding == "ros2msg"
                        && Topic::ALL
                            .into_iter()
                            .find(|topic| header.name == topic.schema_name())
                            .is_some_and(|topic| is_known(&data, &topic.schema_text()));
                    (header.name, same)
                });
            }
            Record::Channel(channel) => {
                if let Some(topic) = Topic::of_channel(&channel.topic) {
                    match self.schemas.get(&channel.schema_id) {
                        Some((name, true)) if *name == topic.schema_name() => {}
                        Some((name, _)) => return Err(Refused::OtherSchema(name.clone())),
                        None => {
                            return Err(Refused::Damage(format!(
                                "the channel {} has no schema",
                                channel.topic
                            )));
                        }
                    }
                    let id = usize::from(channel.id);
                    self.channels.resize(self.channels.len().max(id + 1), None);
                    if let Some(known) = self.channels.get_mut(id) {
                        *known = Some(topic);
                    }
                }
            }
            _ => {}
        }
        Ok(Step::Nothing)
    }

    /// Takes a message, as nearly all records are.
    fn take_message(&mut self, data: &[u8]) -> Result<Step, Refused> {
        let Some((head, data)) = data.split_first_chunk::<MESSAGE_HEAD_LENGTH>() else {
            return Err(Refused::Damage(format!(
                "a message of {} bytes is too short to be one",
                data.len()
            )));
        };
        let [low, high, _, _, _, _, log_time @ .., _, _, _, _, _, _, _, _] = *head;
        let id = usize::from(u16::from_le_bytes([low, high]));
        let Some(Some(topic)) = self.channels.get(id).copied() else {
            return Ok(Step::Nothing);
        };
        let topics = self.topics.as_deref();
        if topics.is_some_and(|topics| !topics.contains(&topic)) {
            return Ok(Step::Skipped);
        }
        self.content.clear();
        self.content.extend_from_slice(data);
        Ok(Step::Message(Recorded {
            topic,
            wall_ns: u64::from_le_bytes(log_time),
        }))
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, RecordError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ending.is_some() {
            return None;
        }
        let Recorded { topic, .. } = match self.advance().transpose()? {
            Ok(recorded) => recorded,
            Err(error) => return Some(Err(error)),
        };
        let entry = Entry::decode(topic, &self.catalogue.content);
        Some(entry.map_err(|reason| self.invalid(topic, &reason)))
    }
}

/// Whether a schema is `ours`, or that of an older program, which knew fewer words: constants are
/// added within a version, and never changed or removed. They take no place in a message.
fn is_known(schema: &[u8], ours: &str) -> bool {
    let Ok(schema) = std::str::from_utf8(schema) else {
        return false;
    };
    let mut theirs = schema.lines().peekable();
    let ours_fit = ours
        .lines()
        .all(|line| theirs.next_if_eq(&line).is_some() || line.contains('='));
    ours_fit && theirs.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layout_that_lacks_words_is_known_and_every_other_one_is_not() {
        let ours = Topic::Tick.schema_text();
        assert!(is_known(ours.as_bytes(), &ours));
        let word = "uint8 REQUEST_CARRIED=10\n";
        let older = ours.replace(word, "");
        assert!(older.len() < ours.len() && is_known(older.as_bytes(), &ours));
        for other in [
            // Newer than this program.
            ours.replace(word, "uint8 REQUEST_CARRIED=10\nuint8 REQUEST_OTHER=11\n"),
            // The number of another word.
            ours.replace(word, "uint8 REQUEST_CARRIED=11\n"),
            // A field less, and one more.
            ours.replacen("uint8 request\n", "", 1),
            format!("{ours}uint8 more\n"),
            String::new(),
        ] {
            assert!(!is_known(other.as_bytes(), &ours));
        }
        assert!(!is_known(&[0xff], &ours));
    }
}
