//! The names of the frames, in the messages that go out.

use clap::Args;
use serde::{Serialize, Serializer, ser::SerializeTuple as _};

/// The names of the frames: by default those of REP 105, which the record has.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub(crate) struct Frames {
    /// Frame of the motion capture
    #[arg(long = "map-frame", value_name = "NAME", default_value = "map", value_parser = name)]
    pub(crate) map: String,
    /// Frame of the odometry; under the name of the map there is no transform between them
    #[arg(long = "odom-frame", value_name = "NAME", default_value = "odom", value_parser = name)]
    pub(crate) odom: String,
    /// Frame of the car
    #[arg(long = "base-frame", value_name = "NAME", default_value = "base_link", value_parser = name)]
    pub(crate) base: String,
}

/// A name that tf2 takes and a description of the car can hold.
fn name(text: &str) -> Result<String, &'static str> {
    let holds = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
    if text.is_empty() || text.starts_with('/') || !text.chars().all(holds) {
        return Err(
            "give letters, digits and _ - . /, not beginning with /, such as car7/base_link",
        );
    }
    Ok(text.to_owned())
}

/// A message that is encoded already: CDR without its header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Encoded(Vec<u8>);

impl Serialize for Encoded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // Bytes are not aligned, and a tuple has no length: these bytes and no others.
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in &self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}

impl Frames {
    /// A message of the record, of this type of ROS, with these names; none if it is not
    /// little-endian CDR, or ends within the names.
    pub(crate) fn encode(&self, kind: &str, bytes: &[u8]) -> Option<Encoded> {
        let mut copy = Copying {
            frames: self,
            from: bytes.strip_prefix(&[0, 1, 0, 0])?,
            read: 0,
            to: Vec::with_capacity(bytes.len() + 64),
        };
        match kind {
            "DiagnosticArray" | "Log" => copy.bytes(copy.from.len(), 1)?,
            "TFMessage" => copy.transforms()?,
            _ => {
                copy.bytes(8, 4)?;
                copy.frame()?;
                if kind == "Odometry" {
                    copy.frame()?;
                }
                let is_short = kind == "AckermannDriveStamped";
                let align = if is_short { 4 } else { 8 };
                let read = copy.read.next_multiple_of(align);
                copy.bytes(copy.from.len().checked_sub(read)?, align)?;
            }
        }
        Some(Encoded(copy.to))
    }
}

/// A message on its way from one buffer to another. Names of another length move what is aligned.
struct Copying<'a> {
    frames: &'a Frames,
    from: &'a [u8],
    read: usize,
    to: Vec<u8>,
}

impl<'a> Copying<'a> {
    /// Copies bytes that begin at a multiple of `align`.
    fn bytes(&mut self, count: usize, align: usize) -> Option<()> {
        self.read = self.read.next_multiple_of(align);
        let padded = self.to.len().next_multiple_of(align);
        self.to.resize(padded, 0);
        let end = self.read.checked_add(count)?;
        self.to.extend_from_slice(self.from.get(self.read..end)?);
        self.read = end;
        Some(())
    }

    /// Copies a frame by its name, which is returned.
    fn frame(&mut self) -> Option<&'a str> {
        self.bytes(4, 4)?;
        let length = self.to.split_off(self.to.len() - 4);
        let length = u32::from_le_bytes(length.try_into().ok()?) as usize;
        let end = self.read.checked_add(length)?;
        let recorded = self.from.get(self.read..end)?.strip_suffix(&[0])?;
        self.read = end;
        let name = match recorded {
            b"map" => &self.frames.map,
            b"odom" => &self.frames.odom,
            b"base_link" => &self.frames.base,
            other => str::from_utf8(other).ok()?,
        };
        let length = u32::try_from(name.len() + 1).ok()?;
        self.to.extend_from_slice(&length.to_le_bytes());
        self.to.extend_from_slice(name.as_bytes());
        self.to.push(0);
        Some(name)
    }

    /// Copies the transforms but those between frames of one name.
    fn transforms(&mut self) -> Option<()> {
        self.bytes(4, 4)?;
        let count = u32::from_le_bytes(self.to.as_slice().try_into().ok()?);
        let mut kept = count;
        for _ in 0..count {
            let begin = self.to.len();
            self.bytes(8, 4)?;
            let (parent, child) = (self.frame()?, self.frame()?);
            self.bytes(7 * 8, 8)?;
            if parent == child {
                self.to.truncate(begin);
                kept -= 1;
            }
        }
        self.to.get_mut(..4)?.copy_from_slice(&kept.to_le_bytes());
        Some(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    fn frames(map: &str, odom: &str, base: &str) -> Frames {
        let [map, odom, base] = [map, odom, base].map(str::to_owned);
        Frames { map, odom, base }
    }

    /// A message as CDR encodes it: a stamp, frames, and numbers; a list of them for transforms.
    fn message(list: bool, parts: &[(&[&str], usize)]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pad = |bytes: &mut Vec<u8>, align| {
            bytes.resize(bytes.len().next_multiple_of(align), 0);
        };
        if list {
            bytes.extend((parts.len() as u32).to_le_bytes());
        }
        for (names, numbers) in parts {
            pad(&mut bytes, 4);
            bytes.extend([7; 8]);
            for name in *names {
                pad(&mut bytes, 4);
                bytes.extend((name.len() as u32 + 1).to_le_bytes());
                bytes.extend(name.as_bytes());
                bytes.push(0);
            }
            pad(&mut bytes, 8);
            (0..*numbers).for_each(|number| bytes.extend((number as f64).to_le_bytes()));
        }
        [vec![0, 1, 0, 0], bytes].concat()
    }

    #[test]
    fn frames_have_the_given_names_and_everything_else_stays() {
        let rep105 = frames("map", "odom", "base_link");
        let other = frames("world", "car7/odom", "car7/base");
        for (kind, names, renamed, numbers) in [
            (
                "Odometry",
                &["odom", "base_link"][..],
                &["car7/odom", "car7/base"][..],
                85,
            ),
            ("PointStamped", &["map"], &["world"], 3),
            ("Imu", &["base_link"], &["car7/base"], 37),
            ("PoseStamped", &["elsewhere"], &["elsewhere"], 7),
        ] {
            let recorded = message(false, &[(names, numbers)]);
            let expected = message(false, &[(renamed, numbers)]);
            let encoded = |frames: &Frames| frames.encode(kind, &recorded).unwrap().0;
            assert_eq!(encoded(&rep105), recorded[4..], "{kind}");
            assert_eq!(encoded(&other), expected[4..], "{kind}");
            assert_eq!(other.encode(kind, &recorded[..17]), None, "{kind}");
        }
    }

    #[test]
    fn a_map_under_the_name_of_the_odometry_has_no_transform_to_it() {
        let chain: &[(&[&str], usize)] = &[(&["map", "odom"], 7), (&["odom", "base_link"], 7)];
        let recorded = message(true, chain);
        let encoded = |frames: &Frames| frames.encode("TFMessage", &recorded).unwrap().0;
        assert_eq!(encoded(&frames("map", "odom", "base_link")), recorded[4..]);
        let one = message(true, &[(&["world", "base_link"], 7)]);
        assert_eq!(encoded(&frames("world", "world", "base_link")), one[4..]);
    }

    #[test]
    fn a_name_that_tf2_refuses_is_refused() {
        for text in ["", "/map", "a b", "a<b"] {
            assert!(name(text).is_err(), "{text}");
        }
        assert!(name("car-7/base_link.2").is_ok());
    }
}
