//! The chunks of an MCAP file, which are compressed sequences of records, and its parts, which are
//! parsed once their lengths are known to be possible.
//!
//! [`mcap::parse_record`] reserves as much memory as a damaged length asks for, up to 4 GB, and
//! panics if an attachment is shorter than its head and its checksum.

use mcap::{
    McapError,
    records::{ChunkHeader, Record, op},
};

/// The largest length of a part of a record. A larger one is damage, and must not be
/// allocated.
pub(crate) const MAX_PART_LENGTH: usize = 16 << 20;

/// The records of one chunk. It is reused for all chunks of a file and keeps its memory.
#[derive(Default)]
pub(crate) struct Chunk {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    content: Vec<u8>,
    at: usize,
}

impl Chunk {
    /// Opens the chunk that the content of a part of the file encodes.
    pub(crate) fn open_part(&mut self, content: &[u8]) -> Result<(), String> {
        match parse_record(op::CHUNK, content).map_err(|error| error.to_string())? {
            Record::Chunk { header, data } => self.open(&header, &data, MAX_PART_LENGTH),
            _ => Ok(()),
        }
    }

    /// Decompresses a whole chunk and checks it before any of its records is used. A chunk
    /// of more than `limit` bytes is refused.
    fn open(&mut self, header: &ChunkHeader, data: &[u8], limit: usize) -> Result<(), String> {
        self.content.clear();
        self.at = 0;
        let size = usize::try_from(header.uncompressed_size).unwrap_or(usize::MAX);
        if size > limit {
            return Err(format!(
                "a chunk of {size} bytes, more than the {limit} that one may have"
            ));
        }
        match header.compression.as_str() {
            "" => self.content.extend_from_slice(data),
            "zstd" => self.decompress(data, size)?,
            other => {
                return Err(format!(
                    "a chunk is compressed with {other:?}; only zstd is known"
                ));
            }
        }
        let checked = check(&self.content, size, header.uncompressed_crc);
        if checked.is_err() {
            self.content.clear();
        }
        checked
    }

    /// In one call, into memory that need not be cleared first.
    fn decompress(&mut self, data: &[u8], size: usize) -> Result<(), String> {
        let failed = |error| format!("a chunk does not decompress: {error}");
        self.content.reserve(size);
        let zstd = match &mut self.zstd {
            Some(zstd) => zstd,
            none => none.insert(zstd::bulk::Decompressor::new().map_err(failed)?),
        };
        zstd.decompress_to_buffer(data, &mut self.content)
            .map(drop)
            .map_err(failed)
    }

    /// The next record: opcode and content.
    pub(crate) fn next(&mut self) -> Option<Result<(u8, &[u8]), String>> {
        let mut rest = self.content.get(self.at..)?;
        if rest.is_empty() {
            return None;
        }
        let Some((opcode, content)) = split_record(&mut rest) else {
            self.at = self.content.len();
            let why = "a record in a chunk is longer than the rest of it";
            return Some(Err(why.to_owned()));
        };
        self.at = self.content.len() - rest.len();
        Some(Ok((opcode, content)))
    }
}

/// Takes the first record of some bytes: opcode and content.
pub(crate) fn split_record<'a>(rest: &mut &'a [u8]) -> Option<(u8, &'a [u8])> {
    let (&opcode, after) = rest.split_first()?;
    let (length, after) = after.split_first_chunk()?;
    let (content, after) =
        after.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    *rest = after;
    Some((opcode, content))
}

/// Checks what a chunk holds; a checksum of zero is none.
fn check(content: &[u8], size: usize, checksum: u32) -> Result<(), String> {
    let (length, actual) = (content.len(), crc32fast::hash(content));
    if length != size {
        Err(format!("a chunk holds {length} bytes instead of {size}"))
    } else if ![0, actual].contains(&checksum) {
        Err(format!(
            "the checksum of a chunk is {actual:08x} instead of {checksum:08x}"
        ))
    } else {
        Ok(())
    }
}

/// Whether a part with this opcode and content is valid in the data section, outside a
/// chunk. Messages, schemas and channels are always in chunks. Any other part is damage:
/// one flipped bit in an opcode makes a reader skip a part or see the end of the data.
pub(crate) fn is_data_part(opcode: u8, content: &[u8]) -> bool {
    match opcode {
        op::HEADER | op::CHUNK | op::ATTACHMENT | op::METADATA => true,
        // A channel, and a list after its length.
        op::MESSAGE_INDEX => content
            .split_at_checked(2)
            .and_then(|(_, list)| list.split_first_chunk())
            .is_some_and(|(length, list)| {
                usize::try_from(u32::from_le_bytes(*length)) == Ok(list.len())
            }),
        // Nothing but a checksum.
        op::DATA_END => content.len() == 4,
        _ => false,
    }
}

/// A field of a part, for its length.
#[derive(Clone, Copy)]
enum FieldLayout {
    /// This number of bytes.
    Bytes(usize),
    /// A text or a list, after its length in bytes.
    Counted,
    /// Data after their length of eight bytes.
    Long,
    /// A list of pairs of texts, after its length in bytes.
    Texts,
}

/// The fields of a part up to the last one with a length.
const fn fields(opcode: u8) -> &'static [FieldLayout] {
    use FieldLayout::{Bytes, Counted, Long, Texts};
    match opcode {
        op::HEADER => &[Counted, Counted],
        op::SCHEMA => &[Bytes(2), Counted, Counted, Counted],
        op::CHANNEL => &[Bytes(4), Counted, Counted, Texts],
        op::CHUNK => &[Bytes(28), Counted, Long],
        op::MESSAGE_INDEX => &[Bytes(2), Counted],
        op::CHUNK_INDEX => &[Bytes(32), Counted, Bytes(8), Counted],
        op::ATTACHMENT => &[Bytes(16), Counted, Counted, Long, Bytes(4)],
        op::ATTACHMENT_INDEX => &[Bytes(40), Counted, Counted],
        op::STATISTICS => &[Bytes(42), Counted],
        op::METADATA => &[Counted, Texts],
        op::METADATA_INDEX => &[Bytes(16), Counted],
        _ => &[],
    }
}

/// What follows `length` bytes.
fn after(content: &[u8], length: u64) -> Option<&[u8]> {
    content.get(usize::try_from(length).ok()?..)
}

/// A list of bytes, and what follows it.
fn counted(content: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = content.split_first_chunk()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

/// What follows a field; `None` if the field is not whole.
fn after_field(field: FieldLayout, content: &[u8]) -> Option<&[u8]> {
    match field {
        FieldLayout::Bytes(length) => content.get(length..),
        FieldLayout::Counted => Some(counted(content)?.1),
        FieldLayout::Long => {
            let (length, rest) = content.split_first_chunk()?;
            after(rest, u64::from_le_bytes(*length))
        }
        FieldLayout::Texts => {
            let (mut texts, rest) = counted(content)?;
            while !texts.is_empty() {
                texts = counted(texts)?.1;
            }
            Some(rest)
        }
    }
}

/// Parses a part of a file as [`mcap::parse_record`] does. The memory that it takes is bounded by
/// that of the part.
///
/// # Errors
/// The content is no such part.
pub fn parse_record(opcode: u8, content: &[u8]) -> Result<Record<'_>, McapError> {
    let mut rest = content;
    for field in fields(opcode) {
        rest = after_field(*field, rest).ok_or(McapError::UnexpectedEof)?;
    }
    mcap::parse_record(opcode, content)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use std::collections::BTreeMap;

    use mcap::{Attachment, records::Metadata};

    use super::*;

    /// Two records: opcodes 5 and 3, of three bytes and none.
    const RECORDS: [u8; 21] = [
        5, 3, 0, 0, 0, 0, 0, 0, 0, 7, 8, 9, 3, 0, 0, 0, 0, 0, 0, 0, 0,
    ];
    const LIMIT: usize = 1 << 10;

    fn header(compression: &str) -> ChunkHeader {
        ChunkHeader {
            message_start_time: 0,
            message_end_time: 0,
            uncompressed_size: RECORDS.len() as u64,
            uncompressed_crc: crc32fast::hash(&RECORDS),
            compression: compression.to_owned(),
            compressed_size: 0,
        }
    }

    fn records(chunk: &mut Chunk) -> Vec<(u8, Vec<u8>)> {
        let mut records = Vec::new();
        while let Some(record) = chunk.next() {
            let (opcode, content) = record.unwrap();
            records.push((opcode, content.to_vec()));
        }
        records
    }

    #[test]
    fn a_chunk_gives_its_records_compressed_or_not() {
        let compressed = zstd::bulk::compress(&RECORDS, 3).unwrap();
        let mut chunk = Chunk::default();
        assert!(chunk.next().is_none());
        for (compression, data) in [("", &RECORDS[..]), ("zstd", &compressed)] {
            chunk.open(&header(compression), data, LIMIT).unwrap();
            let expected = vec![(5, vec![7, 8, 9]), (3, Vec::new())];
            assert_eq!(records(&mut chunk), expected);
        }
    }

    #[test]
    fn nothing_of_a_damaged_chunk_is_given() {
        let mut chunk = Chunk::default();
        let good = header("");
        for (header, data, expected) in [
            (
                ChunkHeader {
                    uncompressed_size: 1 << 40,
                    ..good.clone()
                },
                &RECORDS[..],
                "more than the 1024 that one may have",
            ),
            (header("lz4"), &RECORDS[..], "compressed with \"lz4\""),
            (header("zstd"), &RECORDS[..], "does not decompress"),
            (good.clone(), &RECORDS[..20], "20 bytes instead of 21"),
            (
                ChunkHeader {
                    uncompressed_crc: 1,
                    ..good.clone()
                },
                &RECORDS[..],
                "instead of 00000001",
            ),
        ] {
            chunk.open(&good, &RECORDS, LIMIT).unwrap();
            let error = chunk.open(&header, data, LIMIT).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
            assert!(chunk.next().is_none());
        }
    }

    #[test]
    fn a_record_that_is_longer_than_its_chunk_ends_it() {
        let mut chunk = Chunk::default();
        for length in [1, 200, 255] {
            let mut bytes = RECORDS;
            // The second record claims more bytes than the chunk has.
            bytes[13..].fill(length);
            let header = ChunkHeader {
                uncompressed_crc: crc32fast::hash(&bytes),
                ..header("")
            };
            chunk.open(&header, &bytes, LIMIT).unwrap();
            assert!(chunk.next().unwrap().is_ok());
            assert!(chunk.next().unwrap().is_err());
            assert!(chunk.next().is_none());
        }
    }

    #[test]
    fn an_attachment_of_any_length_is_parsed_or_refused() {
        let head = [0; 16];
        let texts = b"\x01\0\0\0n\x01\0\0\0m";
        let whole = [&head[..], texts, &[0; 8], &[0; 4]].concat();
        for length in 0..whole.len() {
            assert!(parse_record(op::ATTACHMENT, &whole[..length]).is_err());
        }
        let Record::Attachment { header, data, .. } = parse_record(op::ATTACHMENT, &whole).unwrap()
        else {
            unreachable!("an attachment");
        };
        assert_eq!((header.name.as_str(), data.len()), ("n", 0));
        // A text that reaches to where the checksum should be.
        let mut longer = whole;
        longer[21] = 11;
        assert!(parse_record(op::ATTACHMENT, &longer).is_err());
    }

    /// The parts of a file with every kind of them.
    fn parts() -> Vec<(u8, Vec<u8>)> {
        let mut file = std::io::Cursor::new(Vec::new());
        let mut writer = mcap::Writer::new(&mut file).unwrap();
        let texts = BTreeMap::from([("key".to_owned(), "value".to_owned())]);
        let schema = writer.add_schema("name", "encoding", b"text").unwrap();
        let channel = writer.add_channel(schema, "topic", "cdr", &texts).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 1,
            log_time: 2,
            publish_time: 3,
        };
        writer.write_to_known_channel(&header, b"data").unwrap();
        let attachment = Attachment {
            log_time: 4,
            create_time: 5,
            name: "name".to_owned(),
            media_type: "type".to_owned(),
            data: b"data".as_slice().into(),
        };
        writer.attach(&attachment).unwrap();
        let name = "name".to_owned();
        let metadata = Metadata {
            name,
            metadata: texts,
        };
        writer.write_metadata(&metadata).unwrap();
        writer.finish().unwrap();
        drop(writer);
        let file = file.into_inner();
        let mut rest = &file[mcap::MAGIC.len()..file.len() - mcap::MAGIC.len()];
        let mut parts = Vec::new();
        while let [opcode, after @ ..] = rest {
            let (length, content) = after.split_first_chunk().unwrap();
            let length = usize::try_from(u64::from_le_bytes(*length)).unwrap();
            parts.push((*opcode, content[..length].to_vec()));
            rest = &content[length..];
        }
        parts
    }

    #[test]
    fn every_part_of_a_file_is_parsed_and_no_damaged_length_is_reserved() {
        let mut kinds = Vec::new();
        for (opcode, part) in parts() {
            parse_record(opcode, &part).unwrap();
            kinds.push(opcode);
            let mut rest = part.as_slice();
            for field in fields(opcode) {
                let at = part.len() - rest.len();
                rest = after_field(*field, rest).unwrap();
                let width = match field {
                    FieldLayout::Bytes(_) => continue,
                    FieldLayout::Long => 8,
                    FieldLayout::Counted | FieldLayout::Texts => 4,
                };
                let mut damaged = part.clone();
                damaged[at..at + width].fill(0xff);
                assert!(parse_record(opcode, &damaged).is_err(), "{opcode} at {at}");
                if matches!(field, FieldLayout::Texts) {
                    damaged = part.clone();
                    damaged[at + 4..at + 8].fill(0xff);
                    assert!(parse_record(opcode, &damaged).is_err(), "{opcode} in {at}");
                }
            }
        }
        for kind in [
            op::HEADER,
            op::CHUNK,
            op::MESSAGE_INDEX,
            op::SCHEMA,
            op::CHANNEL,
        ]
        .into_iter()
        .chain([
            op::ATTACHMENT,
            op::METADATA,
            op::STATISTICS,
            op::CHUNK_INDEX,
        ])
        .chain([op::ATTACHMENT_INDEX, op::METADATA_INDEX])
        {
            assert!(kinds.contains(&kind), "no part {kind}");
        }
    }
}
