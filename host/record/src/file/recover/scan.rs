//! A walk through an MCAP file that may be truncated or damaged anywhere.

use std::{
    fs::File,
    io::{self, BufReader, Read, Seek},
    ops::RangeInclusive,
};

use mcap::records::op;

use crate::file::chunk::MAX_PART_LENGTH;

/// Opcode and length of a record.
const HEAD_LENGTH: u64 = 1 + 8;
/// The opcodes of MCAP. Zero is not one of them: a file has zeros where nothing was written.
const OPCODES: RangeInclusive<u8> = op::HEADER..=op::DATA_END;
/// Offset of the name of the compression in a chunk: it follows the head, two times, the
/// size and the checksum.
const NAME_OFFSET: u64 = HEAD_LENGTH + 8 + 8 + 8 + 4;
/// That name after its length, for zstd.
const NAME: [u8; 8] = *b"\x04\0\0\0zstd";

/// How many times the length of the file is read again after damage at the most: a made file may
/// have the head of a long record in each of its places.
const READ_AGAIN: u64 = 4;

/// The records of a file, one after the other.
pub(super) struct Scan {
    file: BufReader<File>,
    /// Where the next record begins.
    pub(super) at: u64,
    /// Length of the file when it was opened: it may still be growing.
    pub(super) length: u64,
    content: Vec<u8>,
    /// Bytes that may still be read again after damage.
    again: u64,
}

/// The result of a search for a record at a place in the file.
pub(super) enum Found<'a> {
    Record {
        opcode: u8,
        content: &'a [u8],
    },
    /// No whole record.
    Nothing,
    /// The end of the file.
    End,
}

impl Scan {
    /// Starts at the beginning of the file.
    pub(super) fn new(file: File) -> io::Result<Self> {
        let length = file.metadata()?.len();
        Ok(Self {
            file: BufReader::with_capacity(64 << 10, file),
            at: 0,
            length,
            content: Vec::new(),
            again: length.saturating_mul(READ_AGAIN),
        })
    }

    /// Skips the magic of a file that is long enough for it; false if another one is there.
    pub(super) fn magic(&mut self) -> io::Result<bool> {
        let mut magic = [0; mcap::MAGIC.len()];
        self.file.read_exact(&mut magic)?;
        self.at = magic.len() as u64;
        Ok(magic == *mcap::MAGIC)
    }

    /// The next record. After [`Found::Nothing`], call [`Scan::resume`] first.
    pub(super) fn next(&mut self) -> io::Result<Found<'_>> {
        if self.at >= self.length {
            return Ok(Found::End);
        }
        let Some((opcode, length)) = self.head()? else {
            return Ok(Found::Nothing);
        };
        self.content.resize(usize::try_from(length).unwrap_or(0), 0);
        self.file.read_exact(&mut self.content)?;
        self.at += HEAD_LENGTH + length;
        Ok(Found::Record {
            opcode,
            content: &self.content,
        })
    }

    /// Reads opcode and length of the record that begins here; none if no whole one does.
    fn head(&mut self) -> io::Result<Option<(u8, u64)>> {
        let rest = self.length.saturating_sub(self.at);
        if rest < HEAD_LENGTH {
            return Ok(None);
        }
        let mut opcode = [0; 1];
        let mut length = [0; 8];
        self.file.read_exact(&mut opcode)?;
        self.file.read_exact(&mut length)?;
        let ([opcode], length) = (opcode, u64::from_le_bytes(length));
        let whole = OPCODES.contains(&opcode)
            && length <= MAX_PART_LENGTH as u64
            && length <= rest.saturating_sub(HEAD_LENGTH);
        Ok(whole.then_some((opcode, length)))
    }

    /// Continues after damage that began at `from`: at the next record, or else at the
    /// next chunk, or else at the end of the file.
    pub(super) fn resume(&mut self, from: u64) -> io::Result<()> {
        // A record that was read whole is damaged in its content only.
        if self.at > from {
            let next = self.head()?.is_some() || self.at >= self.length;
            self.go_to(self.at)?;
            if next {
                return Ok(());
            }
        }
        let again = self.at.saturating_sub(from);
        let from = match self.again.checked_sub(again) {
            Some(left) => {
                self.again = left;
                from
            }
            None => self.at.max(from),
        };
        // The head of a chunk is found by the name of the compression in it.
        let mut window = [0; NAME.len()];
        let mut end = from + 1 + NAME_OFFSET;
        self.go_to(end.min(self.length))?;
        let mut byte = [0];
        while end < self.length {
            self.file.read_exact(&mut byte)?;
            end += 1;
            window.rotate_left(1);
            if let Some(last) = window.last_mut() {
                [*last] = byte;
            }
            let start = (end - NAME_OFFSET).saturating_sub(NAME.len() as u64);
            if window == NAME && start > from {
                self.at = start;
                return self.go_to(start);
            }
        }
        self.at = self.length;
        Ok(())
    }

    /// Goes to a place in the file, and keeps what was read around it.
    fn go_to(&mut self, place: u64) -> io::Result<()> {
        let here = self.file.stream_position()?;
        self.file.seek_relative(place.wrapping_sub(here) as i64)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn a_file_made_of_heads_of_long_records_is_read_a_bounded_number_of_times() {
        const LENGTH: usize = 1 << 20;
        // In each place a chunk that claims half of the file, and is none.
        let mut head = vec![op::CHUNK];
        head.extend((LENGTH as u64 / 2).to_le_bytes());
        head.resize(NAME_OFFSET as usize, 0);
        head.extend(NAME);
        let mut file = tempfile::tempfile().unwrap();
        for _ in 0..LENGTH / head.len() {
            file.write_all(&head).unwrap();
        }
        file.rewind().unwrap();
        let mut scan = Scan::new(file).unwrap();
        let mut read = 0;
        let mut places = 0;
        loop {
            let from = scan.at;
            match scan.next().unwrap() {
                Found::End => break,
                Found::Nothing => {}
                Found::Record { content, .. } => read += content.len() as u64,
            }
            scan.resume(from).unwrap();
            assert!(scan.at > from);
            places += 1;
        }
        assert!(places > 1_000, "{places}");
        assert!(read <= (READ_AGAIN + 2) * scan.length, "{read}");
    }
}
