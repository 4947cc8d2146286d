//! Fields for serde: integers have a fixed width and are little-endian, which postcard by itself
//! encodes in a varying number of bytes.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::DeserializeOwned};

/// A field of a message; what is no integer is encoded as serde does.
pub(crate) trait Wire: Serialize + DeserializeOwned {
    fn to_wire<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.serialize(serializer)
    }

    fn from_wire<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::deserialize(deserializer)
    }
}

pub(crate) fn serialize<T: Wire, S: Serializer>(
    field: &T,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    field.to_wire(serializer)
}

pub(crate) fn deserialize<'de, T: Wire, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<T, D::Error> {
    T::from_wire(deserializer)
}

/// Types as arrays of bytes.
macro_rules! bytes {
    ($($type:ty as $bytes:ty: $to:expr, $from:expr;)+) => {
        $(impl Wire for $type {
            fn to_wire<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                $to(*self).serialize(serializer)
            }

            fn from_wire<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                <$bytes>::deserialize(deserializer).map($from)
            }
        })+
    };
}

bytes! {
    u16 as [u8; 2]: u16::to_le_bytes, u16::from_le_bytes;
    i16 as [u8; 2]: i16::to_le_bytes, i16::from_le_bytes;
    u32 as [u8; 4]: u32::to_le_bytes, u32::from_le_bytes;
    [i16; 3] as [[u8; 2]; 3]: each, |bytes| bytes.map(i16::from_le_bytes);
    [i16; 4] as [[u8; 2]; 4]: each, |bytes| bytes.map(i16::from_le_bytes);
}

fn each<const N: usize>(values: [i16; N]) -> [[u8; 2]; N] {
    values.map(i16::to_le_bytes)
}

impl Wire for bool {}
impl Wire for u8 {}
impl Wire for [u8; 3] {}
impl Wire for crate::Sequence {}
