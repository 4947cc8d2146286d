//! A bounded little-endian cursor that can fill in sizes afterwards.

use super::EncodeError;
use crate::codec::{HEADER_LEN, MAX_DATAGRAM_LEN, MessageId};

pub(super) struct Writer<'a> {
    out: &'a mut [u8],
    len: usize,
}

/// The place of a size that is filled in later.
pub(super) struct SizeSlot(usize);

impl<'a> Writer<'a> {
    /// Begins a message; its length is filled in by [`finish`](Self::finish).
    pub(super) fn message(out: &'a mut [u8], id: MessageId) -> Result<Self, EncodeError> {
        let mut writer = Self { out, len: 0 };
        writer.u16(id as u16, "message id")?;
        writer.u16(0, "payload length")?;
        Ok(writer)
    }

    /// Completes the header and returns the datagram's length.
    pub(super) fn finish(self) -> Result<usize, EncodeError> {
        let too_long = EncodeError::TooLong {
            len: self.len,
            max: MAX_DATAGRAM_LEN,
        };
        if self.len > MAX_DATAGRAM_LEN {
            return Err(too_long);
        }
        let payload = u16::try_from(self.len.saturating_sub(HEADER_LEN)).map_err(|_| too_long)?;
        if let Some(slot) = self.out.get_mut(2..4) {
            slot.copy_from_slice(&payload.to_le_bytes());
        }
        Ok(self.len)
    }

    pub(super) fn bytes(&mut self, bytes: &[u8], field: &'static str) -> Result<(), EncodeError> {
        let capacity = self.out.len();
        let end = self.len.saturating_add(bytes.len());
        let Some(slot) = self.out.get_mut(self.len..end) else {
            return Err(EncodeError::BufferTooSmall { field, capacity });
        };
        slot.copy_from_slice(bytes);
        self.len = end;
        Ok(())
    }

    pub(super) fn u8(&mut self, value: u8, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&[value], field)
    }

    pub(super) fn u16(&mut self, value: u16, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn u32(&mut self, value: u32, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn i32(&mut self, value: i32, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn u64(&mut self, value: u64, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn f32(&mut self, value: f32, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn f64(&mut self, value: f64, field: &'static str) -> Result<(), EncodeError> {
        self.bytes(&value.to_le_bytes(), field)
    }

    pub(super) fn f32s(&mut self, values: &[f32], field: &'static str) -> Result<(), EncodeError> {
        values.iter().try_for_each(|value| self.f32(*value, field))
    }

    pub(super) fn count(&mut self, count: usize, field: &'static str) -> Result<(), EncodeError> {
        let value = i32::try_from(count).map_err(|_| EncodeError::CountOutOfRange {
            field,
            value: count,
        })?;
        self.i32(value, field)
    }

    pub(super) fn c_str(&mut self, text: &str, field: &'static str) -> Result<(), EncodeError> {
        self.c_bytes(text.as_bytes(), field)
    }

    pub(super) fn c_bytes(&mut self, text: &[u8], field: &'static str) -> Result<(), EncodeError> {
        if text.contains(&0) {
            return Err(EncodeError::InteriorNul { field });
        }
        self.bytes(text, field)?;
        self.u8(0, field)
    }

    /// A name in a field of `N` bytes, padded with zeros, NUL included.
    pub(super) fn padded_name<const N: usize>(
        &mut self,
        name: &str,
        field: &'static str,
    ) -> Result<(), EncodeError> {
        if name.bytes().any(|byte| byte == 0) {
            return Err(EncodeError::InteriorNul { field });
        }
        let mut padded = [0; N];
        match padded.get_mut(..name.len()) {
            Some(slot) if name.len() < N => slot.copy_from_slice(name.as_bytes()),
            _ => {
                return Err(EncodeError::NameTooLong {
                    field,
                    len: name.len(),
                    max: N.saturating_sub(1),
                });
            }
        }
        self.bytes(&padded, field)
    }

    /// Leaves room for the size of the part that follows.
    pub(super) fn size_slot(&mut self, field: &'static str) -> Result<SizeSlot, EncodeError> {
        let slot = SizeSlot(self.len);
        self.i32(0, field)?;
        Ok(slot)
    }

    /// Fills in the size of the part written since [`size_slot`](Self::size_slot).
    #[expect(clippy::needless_pass_by_value, reason = "a slot is filled in once")]
    pub(super) fn fill(&mut self, slot: SizeSlot, field: &'static str) -> Result<(), EncodeError> {
        let start = slot.0.saturating_add(4);
        let value = self.len.saturating_sub(start);
        let size =
            i32::try_from(value).map_err(|_| EncodeError::CountOutOfRange { field, value })?;
        if let Some(bytes) = self.out.get_mut(slot.0..start) {
            bytes.copy_from_slice(&size.to_le_bytes());
        }
        Ok(())
    }
}
