//! Arrays of `i16` as fixed-width little-endian bytes.
//!
//! `postcard::fixint` covers only single integers.

use serde::{
    Deserialize, Deserializer, Serializer,
    de::{Error, SeqAccess, Visitor},
    ser::SerializeTuple,
};

pub(crate) fn serialize<const N: usize, S: Serializer>(
    values: &[i16; N],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut tuple = serializer.serialize_tuple(N)?;
    for value in values {
        tuple.serialize_element(&value.to_le_bytes())?;
    }
    tuple.end()
}

pub(crate) fn deserialize<'de, const N: usize, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<[i16; N], D::Error> {
    struct Values<const N: usize>;

    impl<'de, const N: usize> Visitor<'de> for Values<N> {
        type Value = [i16; N];

        fn expecting(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
            formatter.write_str("little-endian 16-bit integers")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
            let mut values = [0; N];
            for (index, value) in values.iter_mut().enumerate() {
                let bytes: LeBytes = sequence
                    .next_element()?
                    .ok_or_else(|| A::Error::invalid_length(index, &self))?;
                *value = i16::from_le_bytes(bytes.0);
            }
            Ok(values)
        }
    }

    #[derive(Deserialize)]
    struct LeBytes([u8; 2]);

    deserializer.deserialize_tuple(N, Values)
}
