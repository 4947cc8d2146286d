//! Messages as they are on the wire: all numbers are big-endian, and bodies are padded to
//! multiples of eight bytes.

/// What both sides say first.
pub const COOKIE: [u8; 24] = *b"vrpn: ver. 07.38  0\0\0\0\0\0";

/// The beginning of a cookie of every version with which this one works.
pub const COOKIE_BEGINNING: &[u8] = b"vrpn: ver. 07.";

/// The name of the type of a pose.
pub const POSE: &str = "vrpn_Tracker Pos_Quat";
/// The name of the type of a question that every object answers at once.
pub const PING: &str = "vrpn_Base ping_message";
/// The name of the type of that answer.
pub const PONG: &str = "vrpn_Base pong_message";

/// The type of a message that describes a sender.
pub const SENDER_DESCRIPTION: i32 = -1;
/// The type of a message that describes a type.
pub const TYPE_DESCRIPTION: i32 = -2;
/// The type of a message that says where datagrams are expected: the port is its sender.
pub const UDP_DESCRIPTION: i32 = -3;

const HEADER_LEN: usize = 24;

/// A message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// The sender's stamp, in microseconds since 1970.
    pub stamp_us: u64,
    /// The sender's number, which is this side's own.
    pub sender: i32,
    /// The type's number, which is this side's own; below zero it is the connection's.
    pub kind: i32,
    /// Contents.
    pub body: &'a [u8],
}

/// The first bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the length {length} is less than that of a header, or too large")]
pub struct NotAMessage {
    /// The length that they give.
    pub length: u32,
}

/// A pose in a message of the type [`POSE`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The sensor's number.
    pub sensor: i32,
    /// Position x, y, z, in metres.
    pub position_m: [f64; 3],
    /// Quaternion x, y, z, w.
    pub orientation_xyzw: [f64; 4],
}

impl<'a> Message<'a> {
    /// The first message of `bytes`, and its length on the wire; `None` if it is not complete.
    ///
    /// # Errors
    /// The bytes are no message.
    pub fn read(bytes: &'a [u8]) -> Result<Option<(Self, usize)>, NotAMessage> {
        let Some((length, rest)) = u32_of(bytes) else {
            return Ok(None);
        };
        if !(HEADER_LEN..=crate::stream::LONGEST).contains(&(length as usize)) {
            return Err(NotAMessage { length });
        }
        let body_len = length as usize - HEADER_LEN;
        let whole_len = HEADER_LEN + body_len.next_multiple_of(8);
        let (Some((seconds, rest)), true) = (u32_of(rest), bytes.len() >= whole_len) else {
            return Ok(None);
        };
        let numbers = || {
            let (microseconds, rest) = u32_of(rest)?;
            let (sender, rest) = u32_of(rest)?;
            let (kind, rest) = u32_of(rest)?;
            // A sequence number follows, which nobody reads.
            let (_, rest) = u32_of(rest)?;
            Some(Self {
                stamp_us: u64::from(seconds) * 1_000_000 + u64::from(microseconds),
                sender: sender.cast_signed(),
                kind: kind.cast_signed(),
                body: rest.get(..body_len)?,
            })
        };
        Ok(numbers().map(|message| (message, whole_len)))
    }

    /// Passes the message's bytes to `put`.
    pub fn write(&self, sequence: u32, put: &mut impl FnMut(&[u8])) {
        let seconds = (self.stamp_us / 1_000_000) as u32;
        let microseconds = (self.stamp_us % 1_000_000) as u32;
        let length = (HEADER_LEN + self.body.len()) as u32;
        let (sender, kind) = (self.sender.cast_unsigned(), self.kind.cast_unsigned());
        for number in [length, seconds, microseconds, sender, kind, sequence] {
            put(&number.to_be_bytes());
        }
        put(self.body);
        let padding = self.body.len().next_multiple_of(8) - self.body.len();
        put([0; 8].get(..padding).unwrap_or_default());
    }

    /// The name in a description of a sender or of a type, if there is one.
    pub fn described(&self) -> Option<&'a [u8]> {
        let (length, rest) = u32_of(self.body)?;
        let name = rest.get(..length as usize)?;
        name.split(|byte| *byte == 0).next()
    }

    /// The pose in a message of the type [`POSE`], if it is one.
    pub fn pose(&self) -> Option<Pose> {
        let (sensor, rest) = u32_of(self.body)?;
        let numbers = rest.get(4..)?;
        if numbers.len() != 56 {
            return None;
        }
        let (values, _) = numbers.as_chunks();
        let mut values = values.iter().map(|bytes| f64::from_be_bytes(*bytes));
        let mut next = || values.next();
        Some(Pose {
            sensor: sensor.cast_signed(),
            position_m: [next()?, next()?, next()?],
            orientation_xyzw: [next()?, next()?, next()?, next()?],
        })
    }
}

/// The body of a description of a sender or of a type.
pub fn description(name: impl AsRef<[u8]>) -> heapless::Vec<u8, 128> {
    let name = name.as_ref();
    let mut body = heapless::Vec::new();
    let length = name.len() as u32 + 1;
    // A name that is too long is cut off, and its length is wrong: there is none.
    let _ = body.extend_from_slice(&length.to_be_bytes());
    let _ = body.extend_from_slice(name);
    let _ = body.push(0);
    body
}

impl Pose {
    /// The body of a message of the type [`POSE`].
    pub fn body(&self) -> heapless::Vec<u8, 64> {
        let mut body = heapless::Vec::new();
        // 64 bytes: they fit.
        let _ = body.extend_from_slice(&self.sensor.to_be_bytes());
        let _ = body.extend_from_slice(&[0; 4]);
        for value in self.position_m.iter().chain(&self.orientation_xyzw) {
            let _ = body.extend_from_slice(&value.to_be_bytes());
        }
        body
    }
}

fn u32_of(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_be_bytes(*number), rest))
}
