//! A `u64` in JSON as 16 hexadecimal digits: JSON numbers lose digits beyond 2^53.

use serde::{Deserialize as _, Deserializer, Serializer, de::Error as _};

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
pub(crate) fn serialize<S: Serializer>(value: &u64, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{value:016x}"))
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
    let text = String::deserialize(deserializer)?;
    u64::from_str_radix(&text, 16)
        .ok()
        .filter(|_| text.len() == 16)
        .ok_or_else(|| D::Error::custom(format!("{text:?} is not 16 hexadecimal digits")))
}
