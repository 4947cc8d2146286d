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
    /// A list has too few elements.
    #[error("has {count} elements in {list}, and the map names number {index}, counted from 0")]
    Element {
        list: String,
        count: u32,
        index: u32,
    },
}

/// What is found at a field.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Found {
    Number(f64),
    Stamp {
        seconds: i32,
        nanoseconds: u32,
    },
    /// No element of a list has the name, but these.
    Absent(Vec<String>),
}

/// A field within a message, as [`Path`](super::path::Path) is resolved.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Target {
    pub(super) steps: Vec<Step>,
    pub(super) end: End,
}

/// One message deeper.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    /// The field, by its place.
    pub(super) field: usize,
    pub(super) pick: Pick,
}

/// Which element of a field.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pick {
    Whole,
    Index(u32),
    /// The first one in which a field, by its place, is this text.
    Named {
        key: usize,
        value: String,
    },
}

/// What is made of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Number(Kind),
    /// The yaw of a quaternion.
    Yaw,
    /// Seconds and nanoseconds.
    Stamp,
}

/// The contents of a message after its header.
pub(super) fn contents(message: &[u8]) -> Result<Reader<'_>, Fault> {
    const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
    let head = message.get(..4).unwrap_or(message);
    let big_endian = match head {
        // The last two bytes are options, which plain CDR does not use.
        [0, 0, ..] if head.len() == 4 => true,
        [0, 1, ..] if head.len() == 4 => false,
        _ if head == ZSTD => return Err(Fault::Compressed),
        _ => return Err(Fault::Header(head.to_owned())),
    };
    Ok(Reader {
        bytes: message.get(4..).unwrap_or_default(),
        at: 0,
        big_endian,
    })
}

/// A place in a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    /// Fails unless the message is as long as its type; writers may fill its last word.
    pub(super) fn check(mut self, definition: &Definition) -> Result<(), Fault> {
        self.skip_message(definition, 0)?;
        match self.bytes.len().saturating_sub(self.at) {
            0..4 => Ok(()),
            extra => Err(Fault::Long(extra)),
        }
    }

    /// Goes to a field of the message and reads it.
    pub(super) fn find(mut self, definition: &Definition, target: &Target) -> Result<Found, Fault> {
        let mut message = 0;
        for Step { field, pick } in &target.steps {
            let fields = definition.fields_of(message);
            for before in fields.get(..*field).unwrap_or_default() {
                self.skip_field(definition, before)?;
            }
            let Some(field) = fields.get(*field) else {
                break;
            };
            match pick {
                Pick::Whole => {}
                Pick::Index(index) => {
                    let count = self.count(field)?;
                    if *index >= count {
                        return Err(Fault::Element {
                            list: field.name.clone(),
                            count,
                            index: *index,
                        });
                    }
                    self.skip_elements(definition, field.kind, *index)?;
                }
                Pick::Named { key, value } => {
                    let names = self.find_named(definition, field, *key, value)?;
                    if let Some(names) = names {
                        return Ok(Found::Absent(names));
                    }
                }
            }
            if let Kind::Message(inner) = field.kind {
                message = inner;
            }
        }
        self.read(target.end)
    }

    /// Goes to the element in which the text at `key` is `value`; returns the texts of all if there is
    /// none.
    fn find_named(
        &mut self,
        definition: &Definition,
        list: &Field,
        key: usize,
        value: &str,
    ) -> Result<Option<Vec<String>>, Fault> {
        let Kind::Message(element) = list.kind else {
            return Ok(Some(Vec::new()));
        };
        let mut names = Vec::new();
        for _ in 0..self.count(list)? {
            let mut inside = *self;
            let fields = definition.fields_of(element);
            for before in fields.get(..key).unwrap_or_default() {
                inside.skip_field(definition, before)?;
            }
            let name = inside.text()?;
            if name == value.as_bytes() {
                return Ok(None);
            }
            names.push(String::from_utf8_lossy(name).into_owned());
            self.skip_message(definition, element)?;
        }
        Ok(Some(names))
    }

    fn read(&mut self, end: End) -> Result<Found, Fault> {
        Ok(match end {
            End::Number(kind) => Found::Number(self.number(kind)?),
            End::Yaw => {
                let mut parts = [0.0; 4];
                for part in &mut parts {
                    *part = self.number(Kind::Float(8))?;
                }
                Found::Number(yaw(parts))
            }
            End::Stamp => Found::Stamp {
                seconds: i32::from_ne_bytes(self.word()?),
                nanoseconds: u32::from_ne_bytes(self.word()?),
            },
        })
    }

    fn number(&mut self, kind: Kind) -> Result<f64, Fault> {
        Ok(match kind {
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
            Kind::Text | Kind::Message(_) => f64::NAN,
        })
    }

    /// The bytes of a text, without the zero at its end.
    fn text(&mut self) -> Result<&'a [u8], Fault> {
        let length = self.length()?;
        let text = self.take(length as usize)?;
        Ok(text.strip_suffix(&[0]).unwrap_or(text))
    }

    fn length(&mut self) -> Result<u32, Fault> {
        Ok(u32::from_ne_bytes(self.word()?))
    }

    /// The number of elements of a field.
    fn count(&mut self, field: &Field) -> Result<u32, Fault> {
        match field.count {
            Count::One => Ok(1),
            Count::Array(length) => Ok(length),
            Count::Sequence => self.length(),
        }
    }

    fn skip_message(&mut self, definition: &Definition, message: usize) -> Result<(), Fault> {
        let fields = definition.fields_of(message);
        if fields.is_empty() {
            // A message without fields has a byte all the same.
            self.take(1)?;
        }
        for field in fields {
            self.skip_field(definition, field)?;
        }
        Ok(())
    }

    fn skip_field(&mut self, definition: &Definition, field: &Field) -> Result<(), Fault> {
        let count = self.count(field)?;
        self.skip_elements(definition, field.kind, count)
    }

    /// Each element has at least a byte: a false length ends with the message.
    fn skip_elements(
        &mut self,
        definition: &Definition,
        kind: Kind,
        count: u32,
    ) -> Result<(), Fault> {
        let size = match kind {
            Kind::Bool => 1,
            Kind::Unsigned(size) | Kind::Signed(size) | Kind::Float(size) => size,
            Kind::Text => {
                for _ in 0..count {
                    self.text()?;
                }
                return Ok(());
            }
            Kind::Message(message) => {
                for _ in 0..count {
                    self.skip_message(definition, message)?;
                }
                return Ok(());
            }
        };
        if count > 0 {
            self.align(size);
            self.take(size.saturating_mul(count as usize))?;
        }
        Ok(())
    }

    /// A number, in the byte order of this computer.
    fn word<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        self.align(N);
        let mut word = [0; N];
        word.copy_from_slice(self.take(N)?);
        if self.big_endian != cfg!(target_endian = "big") {
            word.reverse();
        }
        Ok(word)
    }

    const fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size);
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], Fault> {
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

    use super::*;

    fn target(field: usize, pick: Pick, end: End) -> Target {
        Target {
            steps: vec![Step { field, pick }],
            end,
        }
    }

    #[test]
    fn numbers_are_aligned_in_either_byte_order() {
        let definition = Definition::parse("p/M", "uint8 a\nfloat64 b\nint16[] c").unwrap();
        let little = b"\0\x01\0\0\x07.......\0\0\0\0\0\0\xf8\x3f\x02\0\0\0\xff\xff\x05\0";
        let big = b"\0\0\0\0\x07.......\x3f\xf8\0\0\0\0\0\0\0\0\0\x02\xff\xff\0\x05";
        for message in [&little[..], &big[..]] {
            let reader = contents(message).unwrap();
            reader.check(&definition).unwrap();
            for (field, pick, kind, value) in [
                (0, Pick::Whole, Kind::Unsigned(1), 7.0),
                (1, Pick::Whole, Kind::Float(8), 1.5),
                (2, Pick::Index(0), Kind::Signed(2), -1.0),
                (2, Pick::Index(1), Kind::Signed(2), 5.0),
            ] {
                let found = reader.find(&definition, &target(field, pick, End::Number(kind)));
                assert_eq!(found, Ok(Found::Number(value)));
            }
            let beyond = target(2, Pick::Index(2), End::Number(Kind::Signed(2)));
            let error = reader.find(&definition, &beyond).unwrap_err().to_string();
            assert_eq!(
                error,
                "has 2 elements in c, and the map names number 2, counted from 0"
            );
            let cut = contents(&message[..message.len() - 1]).unwrap();
            assert_eq!(cut.check(&definition), Err(Fault::Short(message.len() - 1)));
            let long = [message, &[0; 4]].concat();
            let long = contents(&long).unwrap().check(&definition);
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
