//! The chunks of an MCAP file: compressed sequences of records.

use mcap::{
    McapError,
    records::{ChunkHeader, Record, op},
};

use super::parse::parse_record;

/// The largest length of a part of a record. A larger one is damage, and must not be
/// allocated.
pub(crate) const MAX_PART_LENGTH: usize = 16 << 20;

/// Opcode and length of a record.
const HEAD_LENGTH: usize = 1 + 8;

/// The records of one chunk. It is reused for all chunks of a file and keeps its memory.
#[derive(Default)]
pub(crate) struct Chunk {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    content: Vec<u8>,
    at: usize,
}

/// Why a chunk is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ChunkError {
    #[error("a chunk of {size} bytes, more than the {limit} that one may have")]
    TooLong { size: u64, limit: usize },
    #[error("a chunk is compressed with {0:?}; only zstd is known")]
    Compression(String),
    #[error("a chunk does not decompress: {0}")]
    Zstd(#[from] std::io::Error),
    #[error("a chunk holds {actual} bytes instead of {expected}")]
    Size { expected: u64, actual: usize },
    #[error("the checksum of a chunk is {actual:08x} instead of {expected:08x}")]
    Checksum { expected: u32, actual: u32 },
    #[error("a record in a chunk is longer than the rest of it")]
    Record,
    #[error(transparent)]
    Container(#[from] McapError),
}

impl Chunk {
    /// Opens the chunk that the content of a part of the file encodes.
    pub(crate) fn open_part(&mut self, content: &[u8]) -> Result<(), ChunkError> {
        match parse_record(op::CHUNK, content)? {
            Record::Chunk { header, data } => self.open(&header, &data, MAX_PART_LENGTH),
            _ => Ok(()),
        }
    }

    /// Decompresses a whole chunk and checks it before any of its records is used. A chunk
    /// of more than `limit` bytes is refused.
    fn open(&mut self, header: &ChunkHeader, data: &[u8], limit: usize) -> Result<(), ChunkError> {
        self.content.clear();
        self.at = 0;
        let size = usize::try_from(header.uncompressed_size)
            .ok()
            .filter(|size| *size <= limit)
            .ok_or(ChunkError::TooLong {
                size: header.uncompressed_size,
                limit,
            })?;
        match header.compression.as_str() {
            "" => self.content.extend_from_slice(data),
            "zstd" => {
                self.content.reserve(size);
                let zstd = match &mut self.zstd {
                    Some(zstd) => zstd,
                    none => none.insert(zstd::bulk::Decompressor::new()?),
                };
                // In one call, into memory that need not be cleared first.
                zstd.decompress_to_buffer(data, &mut self.content)?;
            }
            other => return Err(ChunkError::Compression(other.to_owned())),
        }
        let refused = if self.content.len() == size {
            let actual = crc32fast::hash(&self.content);
            // Zero means that there is no checksum.
            (![0, actual].contains(&header.uncompressed_crc)).then_some(ChunkError::Checksum {
                expected: header.uncompressed_crc,
                actual,
            })
        } else {
            Some(ChunkError::Size {
                expected: header.uncompressed_size,
                actual: self.content.len(),
            })
        };
        match refused {
            Some(error) => {
                self.content.clear();
                Err(error)
            }
            None => Ok(()),
        }
    }

    /// The next record: opcode and content.
    pub(crate) fn next(&mut self) -> Option<Result<(u8, &[u8]), ChunkError>> {
        let rest = self.content.get(self.at..)?;
        if rest.is_empty() {
            return None;
        }
        let record = rest.split_first_chunk().and_then(|(head, rest)| {
            let [opcode, length @ ..]: &[u8; HEAD_LENGTH] = head;
            let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
            Some((*opcode, rest.get(..length)?))
        });
        let Some((opcode, content)) = record else {
            self.at = self.content.len();
            return Some(Err(ChunkError::Record));
        };
        self.at += HEAD_LENGTH + content.len();
        Some(Ok((opcode, content)))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
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
}
