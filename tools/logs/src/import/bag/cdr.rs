//! Messages as ROS 2 encodes them: plain CDR, in either byte order.

use super::definition::{Count, Definition, Field, Kind};

/// Why a message can't be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Fault {
    /// It does not begin as CDR does.
    #[error(
        "begins with {0:02x?}, which is not the header of plain CDR: convert the bag with `ros2 bag convert`"
    )]
    Header(Vec<u8>),
    /// It is compressed.
    #[error(
        "is compressed with zstd: convert the bag with `ros2 bag convert` to one without compression"
    )]
    Compressed,
    /// It ends before its last field.
    #[error(
        "has {0} bytes, and its type needs more: the bag is damaged, or has another version of the type"
    )]
    Short(usize),
    /// It goes on after its last field.
    #[error(
        "has {0} bytes more than its type: the bag has another version of the type; convert it with `ros2 bag convert` to MCAP, which holds the definitions"
    )]
    Long(usize),
    /// A list, by its name, has too few elements: their number, and the index that is wanted.
    #[error("has {1} elements in {0}, and the map names number {2}, counted from 0")]
    Element(String, usize, u32),
}

/// A message, a field of one, or an element of a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value<'a> {
    Number(f64),
    Text(String),
    /// The fields of a message with their values; of a list its elements, without fields.
    Parts(&'a [Field], Vec<Self>),
}

impl Value<'_> {
    pub(super) fn parts(&self) -> &[Self] {
        match self {
            Self::Parts(_, parts) => parts,
            Self::Number(_) | Self::Text(_) => &[],
        }
    }

    /// A field of this message.
    pub(super) fn field(&self, name: &str) -> &Self {
        const ABSENT: &Value<'_> = &Value::Number(f64::NAN);
        let Self::Parts(fields, parts) = self else {
            return ABSENT;
        };
        let mut fields = fields.iter().zip(parts);
        let found = fields.find(|(field, _)| field.name == name);
        found.map_or(ABSENT, |(_, part)| part)
    }

    /// The number, or the yaw of a quaternion.
    pub(super) fn number(&self) -> f64 {
        match self {
            Self::Number(number) => *number,
            Self::Parts(_, parts) => match &parts[..] {
                [x, y, z, w] => yaw([x, y, z, w].map(Self::number)),
                _ => f64::NAN,
            },
            Self::Text(_) => f64::NAN,
        }
    }

    pub(super) fn text(&self) -> &str {
        match self {
            Self::Text(text) => text,
            Self::Number(_) | Self::Parts(..) => "",
        }
    }
}

/// The fields of a message of this type, after its header. Fails unless the message is as long as its
/// type; writers may fill its last word.
pub(super) fn decode<'a>(message: &[u8], definition: &'a Definition) -> Result<Value<'a>, Fault> {
    const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
    let head = message.get(..4).unwrap_or(message);
    let big_endian = match head {
        // The last two bytes are options, which plain CDR does not use.
        [0, 0, ..] if head.len() == 4 => true,
        [0, 1, ..] if head.len() == 4 => false,
        _ if head == ZSTD => return Err(Fault::Compressed),
        _ => return Err(Fault::Header(head.to_owned())),
    };
    let mut reader = Reader {
        bytes: message.get(4..).unwrap_or_default(),
        at: 0,
        big_endian,
    };
    let value = reader.message(definition, 0)?;
    match reader.bytes.len().saturating_sub(reader.at) {
        0..4 => Ok(value),
        extra => Err(Fault::Long(extra)),
    }
}

/// A place in a message.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl Reader<'_> {
    fn message<'d>(
        &mut self,
        definition: &'d Definition,
        message: usize,
    ) -> Result<Value<'d>, Fault> {
        let fields = definition.fields_of(message);
        if fields.is_empty() {
            // A message without fields has a byte all the same.
            self.take(1)?;
        }
        let parts = fields.iter().map(|field| self.field(definition, field));
        Ok(Value::Parts(fields, parts.collect::<Result<_, _>>()?))
    }

    /// Each element of a list has at least a byte: a false length ends with the message.
    fn field<'d>(&mut self, definition: &'d Definition, field: &Field) -> Result<Value<'d>, Fault> {
        let count = match field.count {
            Count::One => return self.value(definition, field.kind),
            Count::Array(length) => length,
            Count::Sequence => self.length()?,
        };
        let elements = (0..count).map(|_| self.value(definition, field.kind));
        Ok(Value::Parts(&[], elements.collect::<Result<_, _>>()?))
    }

    fn value<'d>(&mut self, definition: &'d Definition, kind: Kind) -> Result<Value<'d>, Fault> {
        Ok(Value::Number(match kind {
            Kind::Text => {
                let length = self.length()?;
                let text = self.take(length as usize)?;
                // A zero is at its end.
                let text = text.strip_suffix(&[0]).unwrap_or(text);
                return Ok(Value::Text(String::from_utf8_lossy(text).into_owned()));
            }
            Kind::Message(message) => return self.message(definition, message),
            Kind::Bool => f64::from(u8::from(self.word::<1>()? != [0])),
            Kind::Unsigned(1) => f64::from(u8::from_ne_bytes(self.word()?)),
            Kind::Unsigned(2) => f64::from(u16::from_ne_bytes(self.word()?)),
            Kind::Unsigned(4) => f64::from(u32::from_ne_bytes(self.word()?)),
            Kind::Unsigned(_) => u64::from_ne_bytes(self.word()?) as f64,
            Kind::Signed(1) => f64::from(i8::from_ne_bytes(self.word()?)),
            Kind::Signed(2) => f64::from(i16::from_ne_bytes(self.word()?)),
            Kind::Signed(4) => f64::from(i32::from_ne_bytes(self.word()?)),
            Kind::Signed(_) => i64::from_ne_bytes(self.word()?) as f64,
            Kind::Float(4) => f64::from(f32::from_ne_bytes(self.word()?)),
            Kind::Float(_) => f64::from_ne_bytes(self.word()?),
        }))
    }

    fn length(&mut self) -> Result<u32, Fault> {
        Ok(u32::from_ne_bytes(self.word()?))
    }

    /// A number, in the byte order of this computer.
    fn word<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        self.at = self.at.next_multiple_of(N);
        let mut word = [0; N];
        word.copy_from_slice(self.take(N)?);
        if self.big_endian != cfg!(target_endian = "big") {
            word.reverse();
        }
        Ok(word)
    }

    fn take(&mut self, length: usize) -> Result<&[u8], Fault> {
        let end = self.at.saturating_add(length);
        let bytes = self.bytes.get(self.at..end);
        self.at = end;
        // With the header, as the bag counts.
        bytes.ok_or(Fault::Short(self.bytes.len() + 4))
    }
}

/// The yaw of a quaternion x, y, z, w, which need not have length 1, about an axis that points up;
/// not a number if it is no rotation, or one that tilts by more than 60 degrees: the axis that points up
/// is then another one.
fn yaw([x, y, z, w]: [f64; 4]) -> f64 {
    let length = x * x + y * y + z * z + w * w;
    let up = w * w - x * x - y * y + z * z;
    // A length that is no number is not below it either.
    if !(length > 0.0 && length.is_finite() && up >= 0.5 * length) {
        return f64::NAN;
    }
    libm::atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use super::{
        super::{path::Takes, wanted::Wanted},
        *,
    };

    #[test]
    fn numbers_are_aligned_in_either_byte_order() {
        let definition = Definition::parse("p/M", "uint8 a\nfloat64 b\nint16[] c").unwrap();
        let little = b"\0\x01\0\0\x07.......\0\0\0\0\0\0\xf8\x3f\x02\0\0\0\xff\xff\x05\0";
        let big = b"\0\0\0\0\x07.......\x3f\xf8\0\0\0\0\0\0\0\0\0\x02\xff\xff\0\x05";
        for message in [&little[..], &big[..]] {
            let decoded = decode(message, &definition).unwrap();
            let wanted = |path| Wanted::new(String::new(), path, Takes::Number).unwrap();
            for (path, value) in [("a", 7.0), ("b", 1.5), ("c[0]", -1.0), ("c[1]", 5.0)] {
                let mut wanted = wanted(path);
                let found = wanted.find(&decoded);
                assert_eq!(found, Ok(Some(&Value::Number(value))));
                assert!(wanted.is_found);
            }
            let error = wanted("c[2]").find(&decoded).unwrap_err().to_string();
            assert_eq!(
                error,
                "has 2 elements in c, and the map names number 2, counted from 0"
            );
            let cut = decode(&message[..message.len() - 1], &definition);
            assert_eq!(cut, Err(Fault::Short(message.len() - 1)));
            let long = decode(&[message, &[0; 4]].concat(), &definition);
            assert_eq!(long, Err(Fault::Long(4)));
        }
    }

    #[test]
    fn yaw_is_about_the_vertical_whatever_the_length_of_the_quaternion() {
        let half: f64 = 0.6;
        for scale in [1.0, 0.5, 3.0] {
            let turned = yaw([0.0, 0.0, scale * libm::sin(half), scale * libm::cos(half)]);
            assert!((turned - 1.2).abs() < 1e-12);
        }
        assert!(yaw([0.0; 4]).is_nan());
        assert!(yaw([0.0, f64::NAN, 0.0, 1.0]).is_nan());
        // Upside down, and on its side.
        assert!(yaw([1.0, 0.0, 0.0, 0.0]).is_nan());
        assert!(yaw([0.0, 1.0, 0.0, 1.0]).is_nan());
    }
}
