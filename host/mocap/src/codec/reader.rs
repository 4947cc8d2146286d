//! A bounded little-endian cursor with its offset in the datagram.

use super::error::DecodeError;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    offset: usize,
}

impl<'a> Reader<'a> {
    /// A reader of `bytes`, which begin `offset` bytes into the datagram.
    pub(crate) const fn new(bytes: &'a [u8], offset: usize) -> Self {
        Self {
            rest: bytes,
            offset,
        }
    }

    pub(crate) const fn offset(&self) -> usize {
        self.offset
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.rest.len()
    }

    pub(crate) fn take(
        &mut self,
        len: usize,
        field: &'static str,
    ) -> Result<&'a [u8], DecodeError> {
        let Some((taken, rest)) = self.rest.split_at_checked(len) else {
            return Err(self.truncated(len, field));
        };
        self.rest = rest;
        self.offset += len;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], DecodeError> {
        let Some((taken, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(self.truncated(N, field));
        };
        self.rest = rest;
        self.offset += N;
        Ok(*taken)
    }

    const fn truncated(&self, needed: usize, field: &'static str) -> DecodeError {
        DecodeError::Truncated {
            field,
            offset: self.offset,
            needed,
            available: self.rest.len(),
        }
    }

    pub(crate) fn bytes4(&mut self, field: &'static str) -> Result<[u8; 4], DecodeError> {
        self.array(field)
    }

    pub(crate) fn u8(&mut self, field: &'static str) -> Result<u8, DecodeError> {
        let [byte] = self.array(field)?;
        Ok(byte)
    }

    pub(crate) fn u16(&mut self, field: &'static str) -> Result<u16, DecodeError> {
        self.array(field).map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self, field: &'static str) -> Result<u32, DecodeError> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(crate) fn i32(&mut self, field: &'static str) -> Result<i32, DecodeError> {
        self.array(field).map(i32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self, field: &'static str) -> Result<u64, DecodeError> {
        self.array(field).map(u64::from_le_bytes)
    }

    pub(crate) fn f32(&mut self, field: &'static str) -> Result<f32, DecodeError> {
        self.array(field).map(f32::from_le_bytes)
    }

    pub(crate) fn f64(&mut self, field: &'static str) -> Result<f64, DecodeError> {
        self.array(field).map(f64::from_le_bytes)
    }

    pub(crate) fn f32s<const N: usize>(
        &mut self,
        field: &'static str,
    ) -> Result<[f32; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32(field)?;
        }
        Ok(values)
    }

    /// The bytes of a NUL-terminated string, without the NUL.
    pub(crate) fn c_bytes(&mut self, field: &'static str) -> Result<&'a [u8], DecodeError> {
        let offset = self.offset;
        let Some(len) = self.rest.iter().position(|byte| *byte == 0) else {
            return Err(DecodeError::UnterminatedString { field, offset });
        };
        let bytes = self.take(len, field)?;
        self.take(1, field)?;
        Ok(bytes)
    }

    pub(crate) fn c_str(&mut self, field: &'static str) -> Result<&'a str, DecodeError> {
        let offset = self.offset;
        core::str::from_utf8(self.c_bytes(field)?)
            .map_err(|_| DecodeError::InvalidUtf8 { field, offset })
    }

    /// A count of entries of at least `min_entry_len` bytes each. A count that the
    /// remaining bytes can't hold is an error here, before any loop over it.
    pub(crate) fn count(
        &mut self,
        min_entry_len: usize,
        field: &'static str,
    ) -> Result<usize, DecodeError> {
        let offset = self.offset;
        let count = self.length(field)?;
        self.check_count(count, min_entry_len, field, offset)?;
        Ok(count)
    }

    /// An error for a `count`, read at `offset`, whose entries do not fit into the
    /// remaining bytes.
    pub(crate) fn check_count(
        &self,
        count: usize,
        min_entry_len: usize,
        field: &'static str,
        offset: usize,
    ) -> Result<(), DecodeError> {
        let needed = count.checked_mul(min_entry_len);
        if needed.is_none_or(|needed| needed > self.rest.len()) {
            return Err(DecodeError::ImplausibleCount {
                field,
                offset,
                count,
                available: self.rest.len(),
            });
        }
        Ok(())
    }

    pub(crate) fn length(&mut self, field: &'static str) -> Result<usize, DecodeError> {
        let offset = self.offset;
        let value = self.i32(field)?;
        usize::try_from(value).map_err(|_| DecodeError::NegativeCount {
            field,
            offset,
            value,
        })
    }

    /// Skips `count` entries of `entry_len` bytes.
    pub(crate) fn skip(
        &mut self,
        count: usize,
        entry_len: usize,
        field: &'static str,
    ) -> Result<(), DecodeError> {
        self.take(count.saturating_mul(entry_len), field).map(drop)
    }

    /// The bytes whose number is in a leading `i32`.
    pub(crate) fn sized(&mut self, field: &'static str) -> Result<Self, DecodeError> {
        let len = self.length(field)?;
        let offset = self.offset;
        Ok(Self::new(self.take(len, field)?, offset))
    }

    /// An error when bytes are left.
    pub(crate) const fn finish(&self, field: &'static str) -> Result<(), DecodeError> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(DecodeError::TrailingBytes {
                field,
                offset: self.offset,
                count: self.rest.len(),
            })
        }
    }
}
