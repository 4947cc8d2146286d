//! The parts of an MCAP file, parsed once their lengths are known to be possible.
//!
//! [`mcap::parse_record`] reserves as much memory as a damaged length asks for, up to 4 GB, and
//! panics if an attachment is shorter than its head and its checksum.

use mcap::{
    McapError,
    records::{Record, op},
};

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
enum Field {
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
const fn fields(opcode: u8) -> &'static [Field] {
    use Field::{Bytes, Counted, Long, Texts};
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
fn after_field(field: Field, content: &[u8]) -> Option<&[u8]> {
    match field {
        Field::Bytes(length) => content.get(length..),
        Field::Counted => Some(counted(content)?.1),
        Field::Long => {
            let (length, rest) = content.split_first_chunk()?;
            after(rest, u64::from_le_bytes(*length))
        }
        Field::Texts => {
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
pub(crate) fn parse_record(opcode: u8, content: &[u8]) -> Result<Record<'_>, McapError> {
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
                    Field::Bytes(_) => continue,
                    Field::Long => 8,
                    Field::Counted | Field::Texts => 4,
                };
                let mut damaged = part.clone();
                damaged[at..at + width].fill(0xff);
                assert!(parse_record(opcode, &damaged).is_err(), "{opcode} at {at}");
                if matches!(field, Field::Texts) {
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
