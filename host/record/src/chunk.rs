//! The part of an MCAP file that is compressed: records, one after the other.

use mcap::records::ChunkHeader;

/// Opcode and length of a record.
const HEAD_LENGTH: usize = 1 + 8;

/// The records of one chunk. One is used for all chunks of a file: it keeps its
/// memory.
#[derive(Default)]
pub(crate) struct Chunk {
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    content: Vec<u8>,
    at: usize,
}

/// Why a chunk is not believed.
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
}

impl Chunk {
    /// Takes in a whole chunk, of which nothing is believed before its checksum.
    /// One that would need more than `limit` bytes is refused.
    pub(crate) fn open(
        &mut self,
        header: &ChunkHeader,
        data: &[u8],
        limit: usize,
    ) -> Result<(), ChunkError> {
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
                // At once, into memory that nobody has had to clear.
                zstd.decompress_to_buffer(data, &mut self.content)?;
            }
            other => return Err(ChunkError::Compression(other.to_owned())),
        }
        let refused = if self.content.len() == size {
            let actual = crc32fast::hash(&self.content);
            // Zero says that nobody calculated one.
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

    /// The next record: its opcode and its content.
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
