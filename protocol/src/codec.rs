//! Encoding and decoding of payloads, for the board.
//!
//! The bytes are the same as postcard's for these types; the host uses postcard,
//! and tests compare the two. On the board, postcard's code would take a quarter of
//! the flash: it is generic, inlined, and checks the remaining room at every byte.
//! Here a field is a function call; missing bytes and invalid numbers set a flag
//! that is read at the end.

/// What a payload is made of.
pub trait Field: Sized {
    /// Appends the value.
    fn write(&self, writer: &mut Writer<'_>);
    /// Reads a value from the front.
    fn read(reader: &mut Reader<'_>) -> Self;
}

/// Writes to a buffer from the front. Bytes that do not fit are dropped.
#[derive(Debug)]
pub struct Writer<'a>(core::slice::IterMut<'a, u8>);

impl<'a> Writer<'a> {
    pub(crate) fn new(buffer: &'a mut [u8]) -> Self {
        Self(buffer.iter_mut())
    }

    /// Number of free bytes.
    pub(crate) fn room(&self) -> usize {
        self.0.len()
    }

    #[inline(always)]
    fn append(&mut self, byte: u8) {
        if let Some(slot) = self.0.next() {
            *slot = byte;
        }
    }

    #[inline(never)]
    fn put_8(&mut self, value: u8) {
        self.append(value);
    }

    #[inline(never)]
    fn put_16(&mut self, value: u16) {
        let [low, high] = value.to_le_bytes();
        self.append(low);
        self.append(high);
    }

    #[inline(never)]
    fn put_32(&mut self, value: u32) {
        self.put_16(value as u16);
        self.put_16((value >> 16) as u16);
    }
}

/// Reads a payload from the front.
#[derive(Debug)]
pub struct Reader<'a> {
    bytes: core::slice::Iter<'a, u8>,
    /// A byte was missing or a number invalid.
    failed: bool,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes: bytes.iter(),
            failed: false,
        }
    }

    /// Whether all values were valid and no byte is left.
    pub(crate) fn finish(self) -> bool {
        !self.failed && self.bytes.len() == 0
    }

    #[inline(always)]
    fn next(&mut self) -> u8 {
        self.bytes.next().copied().unwrap_or_else(|| {
            self.failed = true;
            0
        })
    }

    #[inline(never)]
    fn take_8(&mut self) -> u8 {
        self.next()
    }

    #[inline(never)]
    fn take_16(&mut self) -> u16 {
        let low = self.next();
        u16::from_le_bytes([low, self.next()])
    }

    #[inline(never)]
    fn take_32(&mut self) -> u32 {
        let low = self.take_16();
        u32::from(low) | (u32::from(self.take_16()) << 16)
    }

    /// A number below `count`; any other one is an error and gives zero.
    #[inline(never)]
    pub(crate) fn take_below(&mut self, count: u8) -> u8 {
        let number = self.next();
        if number < count {
            return number;
        }
        self.failed = true;
        0
    }
}

impl Field for u8 {
    fn write(&self, writer: &mut Writer<'_>) {
        writer.put_8(*self);
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        reader.take_8()
    }
}

impl Field for bool {
    fn write(&self, writer: &mut Writer<'_>) {
        writer.put_8(u8::from(*self));
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        reader.take_below(2) != 0
    }
}

impl Field for u16 {
    fn write(&self, writer: &mut Writer<'_>) {
        writer.put_16(*self);
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        reader.take_16()
    }
}

impl Field for i16 {
    fn write(&self, writer: &mut Writer<'_>) {
        writer.put_16(self.cast_unsigned());
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        reader.take_16().cast_signed()
    }
}

impl Field for u32 {
    fn write(&self, writer: &mut Writer<'_>) {
        writer.put_32(*self);
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        reader.take_32()
    }
}

impl<T: Field, const N: usize> Field for [T; N] {
    fn write(&self, writer: &mut Writer<'_>) {
        for element in self {
            element.write(writer);
        }
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        core::array::from_fn(|_| T::read(reader))
    }
}

/// Declares a structure of the wire. The list of its fields stands once: serde's
/// derives, for postcard, and the codec of the board both follow from it, in the
/// order in which the fields are sent.
macro_rules! structure {
    (
        $(#[$about:meta])*
        pub struct $name:ident {
            $( $(#[$field_about:meta])* pub $field:ident: $kind:ty, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub struct $name {
            $( $(#[$field_about])* #[serde(with = "crate::wire")] pub $field: $kind, )*
        }

        impl $crate::wire::Wire for $name {}

        impl $crate::codec::Field for $name {
            fn write(&self, writer: &mut $crate::codec::Writer<'_>) {
                $( $crate::codec::Field::write(&self.$field, writer); )*
            }

            fn read(reader: &mut $crate::codec::Reader<'_>) -> Self {
                Self { $( $field: $crate::codec::Field::read(reader), )* }
            }
        }
    };
}

/// Declares an enumeration of the wire: its variants once, numbered from zero, each
/// with its word. The documentation of a variant is data: what a cause to stop or to refuse means
/// to an operator is there, before `Effect:` and `Remedy:`.
macro_rules! enumeration {
    (
        $(#[$about:meta])*
        pub enum $name:ident {
            $(#[doc = $first_about:literal])* $first:ident = $first_word:literal,
            $( $(#[doc = $variant_about:literal])* $variant:ident = $word:literal, )*
        }
    ) => {
        $crate::words! {
            $(#[$about])*
            pub enum $name: serde {
                $(#[doc = $first_about])* $first = $first_word,
                $( $(#[doc = $variant_about])* $variant = $word, )*
            }
        }

        impl $crate::wire::Wire for $name {}

        impl $crate::codec::Field for $name {
            fn write(&self, writer: &mut $crate::codec::Writer<'_>) {
                $crate::codec::Field::write(&(*self as u8), writer);
            }

            fn read(reader: &mut $crate::codec::Reader<'_>) -> Self {
                match reader.take_below(Self::ALL.len() as u8) {
                    $(number if number == Self::$variant as u8 => Self::$variant,)*
                    _ => Self::$first,
                }
            }
        }
    };
}

pub(crate) use {enumeration, structure};

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use proptest::{array::uniform32, prelude::*};

    use super::{Reader, Writer};
    use crate::{
        Acknowledgement, Arm, Configure, Disarm, Drive, EmergencyStop, Hello, Identity, Jog,
        Message, Refusal, Status, Telemetry,
    };

    /// Reading and writing give the same results as postcard, for any bytes.
    fn agrees_with_postcard<M: Message + PartialEq + Debug>(
        bytes: &[u8],
    ) -> Result<(), TestCaseError> {
        let payload = &bytes[..M::PAYLOAD_LENGTH];
        let mut reader = Reader::new(payload);
        let ours = M::read(&mut reader);
        let ours = reader.finish().then_some(ours);
        let theirs = match postcard::take_from_bytes::<M>(payload) {
            Ok((message, [])) => Some(message),
            _ => None,
        };
        prop_assert_eq!(&ours, &theirs);

        if let Some(message) = ours {
            let mut ours = [0; 64];
            let mut writer = Writer::new(&mut ours);
            message.write(&mut writer);
            let length = 64 - writer.room();
            let mut theirs = [0; 64];
            let theirs = postcard::to_slice(&message, &mut theirs);
            prop_assert_eq!(&ours[..length], theirs.unwrap());
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn every_payload_is_read_and_written_as_postcard_does(
            // Mostly small, or hardly any number would be valid.
            bytes in [(); 2].map(|()| uniform32(prop_oneof![7 => 0_u8..6, 1 => any::<u8>()])),
        ) {
            let bytes = bytes.concat();
            agrees_with_postcard::<Hello>(&bytes)?;
            agrees_with_postcard::<Configure>(&bytes)?;
            agrees_with_postcard::<Arm>(&bytes)?;
            agrees_with_postcard::<Disarm>(&bytes)?;
            agrees_with_postcard::<Drive>(&bytes)?;
            agrees_with_postcard::<EmergencyStop>(&bytes)?;
            agrees_with_postcard::<Jog>(&bytes)?;
            agrees_with_postcard::<Telemetry>(&bytes)?;
            agrees_with_postcard::<Status>(&bytes)?;
            agrees_with_postcard::<Acknowledgement>(&bytes)?;
            agrees_with_postcard::<Refusal>(&bytes)?;
            agrees_with_postcard::<Identity>(&bytes)?;
        }

        #[test]
        fn a_payload_that_is_too_short_or_too_long_is_refused(length in 0_usize..20) {
            let bytes = [1; 20];
            let mut reader = Reader::new(&bytes[..length]);
            let _ = <Drive as super::Field>::read(&mut reader);
            prop_assert_eq!(reader.finish(), length == Drive::PAYLOAD_LENGTH);
        }
    }
}
