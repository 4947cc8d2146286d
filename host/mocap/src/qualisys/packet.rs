//! Packets as they are on the wire, in the byte order of the server's port.

const HEADER_LEN: usize = 8;

/// The byte order of a connection. It follows from the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// Port 22223.
    Little,
    /// Port 22224.
    Big,
}

/// The types of packets that are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// A text: what was refused.
    Error = 0,
    /// A text: a command or its answer.
    Command = 1,
    /// A text: settings.
    Xml = 2,
    /// A frame.
    Data = 3,
    /// No frame comes: nothing is measured.
    NoMoreData = 4,
    /// A byte: what happens in QTM.
    Event = 6,
    /// Anything else.
    Other = u32::MAX,
}

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Its type.
    pub kind: Kind,
    /// What follows the header.
    pub body: &'a [u8],
}

/// The first bytes are no packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the size {size} is less than that of a header, or too large")]
pub struct NotAPacket {
    /// The size that they give.
    pub size: u32,
}

/// The UDP port at which QTM answers who asks for servers.
pub const DISCOVERY_PORT: u16 = 22_226;

/// The question for servers, whose answers go to this port.
pub fn discovery(port: u16) -> [u8; 10] {
    let [high, low] = port.to_be_bytes();
    [10, 0, 0, 0, 7, 0, 0, 0, high, low]
}

/// The port in a question for servers, if it is one.
pub fn discovery_port(question: &[u8]) -> Option<u16> {
    let port = question.strip_prefix(&[10, 0, 0, 0, 7, 0, 0, 0])?;
    Some(u16::from_be_bytes(*port.first_chunk()?))
}

/// The answer of a server: a text about it, and the port below its little-endian one.
pub fn discovered(about: &str, base_port: u16) -> heapless::Vec<u8, 128> {
    let mut answer = heapless::Vec::new();
    let about = about.get(..about.len().min(100)).unwrap_or_default();
    let size = (HEADER_LEN + about.len() + 3) as u32;
    // All of it fits.
    let _ = answer.extend_from_slice(&size.to_le_bytes());
    let _ = answer.extend_from_slice(&(Kind::Command as u32).to_le_bytes());
    let _ = answer.extend_from_slice(about.as_bytes());
    let _ = answer.push(0);
    let _ = answer.extend_from_slice(&base_port.to_be_bytes());
    answer
}

/// A component of a frame that holds bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Component {
    /// Positions and rotation matrices.
    Bodies = 5,
    /// Positions, and roll, pitch and yaw in degrees. It is not read.
    EulerAngles = 6,
    /// The [`Bodies`](Self::Bodies) with residuals.
    WithResiduals = 11,
}

impl Component {
    const fn body_len(self) -> usize {
        match self {
            Self::Bodies => 48,
            Self::EulerAngles => 24,
            Self::WithResiduals => 52,
        }
    }
}

/// A frame's number, time and bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame<'a> {
    /// Microseconds of the server's clock at the exposure.
    pub stamp_us: u64,
    /// The server's number of the frame.
    pub number: u32,
    bodies: &'a [u8],
    body_len: usize,
    order: ByteOrder,
}

/// A body as it is on the wire: not a number if it is not seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameBody {
    /// Position x, y, z, in millimetres.
    pub position_mm: [f32; 3],
    /// The body's axes x, y, z in the server's frame, one after the other.
    pub axes: [[f32; 3]; 3],
    /// Mean distance of the markers from the body, in millimetres.
    pub residual_mm: f32,
}

impl ByteOrder {
    /// The order in which the first packet's size makes sense.
    pub fn of(size: [u8; 4]) -> Self {
        if u32::from_le_bytes(size) <= u32::from_be_bytes(size) {
            Self::Little
        } else {
            Self::Big
        }
    }

    fn u32(self, bytes: &[u8]) -> Option<(u32, &[u8])> {
        let (number, rest) = bytes.split_first_chunk()?;
        let number = match self {
            Self::Little => u32::from_le_bytes(*number),
            Self::Big => u32::from_be_bytes(*number),
        };
        Some((number, rest))
    }

    fn put(self, number: u32) -> [u8; 4] {
        match self {
            Self::Little => number.to_le_bytes(),
            Self::Big => number.to_be_bytes(),
        }
    }

    /// The low and the high half of a long number as they are on the wire, and back.
    const fn halves(self, [low, high]: [u32; 2]) -> [u32; 2] {
        match self {
            Self::Little => [low, high],
            Self::Big => [high, low],
        }
    }
}

impl Kind {
    fn of(number: u32) -> Self {
        use Kind::{Command, Data, Error, Event, NoMoreData, Other, Xml};
        let known = [Error, Command, Xml, Data, NoMoreData, Event];
        let kind = known.into_iter().find(|kind| *kind as u32 == number);
        kind.unwrap_or(Other)
    }
}

impl<'a> Packet<'a> {
    /// The first packet of `bytes`, and its length on the wire; `None` if it is not complete.
    ///
    /// # Errors
    /// The bytes are no packet.
    pub fn read(order: ByteOrder, bytes: &'a [u8]) -> Result<Option<(Self, usize)>, NotAPacket> {
        let Some((size, rest)) = order.u32(bytes) else {
            return Ok(None);
        };
        if !(HEADER_LEN..=crate::stream::LONGEST).contains(&(size as usize)) {
            return Err(NotAPacket { size });
        }
        let length = size as usize;
        Ok(order.u32(rest).and_then(|(kind, rest)| {
            let packet = Self {
                kind: Kind::of(kind),
                body: rest.get(..length - HEADER_LEN)?,
            };
            Some((packet, length))
        }))
    }

    /// Passes the packet's bytes to `put`.
    pub fn write(&self, order: ByteOrder, put: &mut impl FnMut(&[u8])) {
        put(&order.put((HEADER_LEN + self.body.len()) as u32));
        put(&order.put(self.kind as u32));
        put(self.body);
    }

    /// The text of an error, a command or settings.
    pub fn text(&self) -> Option<&'a str> {
        core::str::from_utf8(self.text_bytes()).ok()
    }

    /// That text in whatever encoding it is: names in it may be in another one than the rest.
    pub fn text_bytes(&self) -> &'a [u8] {
        let mut texts = self.body.split(|byte| *byte == 0);
        texts.next().unwrap_or_default()
    }

    /// The frame in a packet of data; `None` if it holds no bodies, or is damaged.
    pub fn frame(&self, order: ByteOrder) -> Option<Frame<'a>> {
        let (first, rest) = order.u32(self.body)?;
        let (second, rest) = order.u32(rest)?;
        let [low, high] = order.halves([first, second]);
        let (number, rest) = order.u32(rest)?;
        let (mut components, mut rest) = order.u32(rest)?;
        while components > 0 {
            components -= 1;
            let (size, after) = order.u32(rest)?;
            let (kind, _) = order.u32(after)?;
            let component = rest.get(HEADER_LEN..size as usize)?;
            rest = rest.get(size as usize..)?;
            let readable = [Component::Bodies, Component::WithResiduals];
            let Some(known) = readable.into_iter().find(|known| *known as u32 == kind) else {
                continue;
            };
            let body_len = known.body_len();
            let (count, component) = order.u32(component)?;
            // Two rates of dropped data, which nobody reads.
            let bodies = component.get(4..)?;
            if bodies.len() != (count as usize).checked_mul(body_len)? {
                return None;
            }
            return Some(Frame {
                stamp_us: u64::from(high) << 32 | u64::from(low),
                number,
                bodies,
                body_len,
                order,
            });
        }
        None
    }
}

impl Frame<'_> {
    /// The bodies, in the order of [`BodyList`](super::BodyList).
    pub fn bodies(&self) -> impl Iterator<Item = FrameBody> {
        self.bodies.chunks_exact(self.body_len).map(|bytes| {
            let mut rest = bytes;
            let mut next = || {
                // Only residuals can be missing.
                let (number, after) = self.order.u32(rest).unwrap_or_default();
                rest = after;
                f32::from_bits(number)
            };
            let mut vector = || [next(), next(), next()];
            FrameBody {
                position_mm: vector(),
                axes: [vector(), vector(), vector()],
                residual_mm: next(),
            }
        })
    }
}

impl FrameBody {
    /// Roll, pitch and yaw in degrees: the rotation is about x, then about the new y, then about
    /// the newest z.
    pub fn euler_deg(&self) -> [f32; 3] {
        let [[xx, _, _], [xy, _, _], [xz, yz, zz]] = self.axes.map(|axis| axis.map(f64::from));
        [
            libm::atan2(-yz, zz),
            libm::asin(xz.clamp(-1.0, 1.0)),
            libm::atan2(-xy, xx),
        ]
        .map(|angle| angle.to_degrees() as f32)
    }
}

/// Passes the bytes of a packet with a frame to `put`: the server's side.
pub fn write_frame(
    order: ByteOrder,
    stamp_us: u64,
    number: u32,
    bodies: &[FrameBody],
    components: &[Component],
    put: &mut impl FnMut(&[u8]),
) {
    let len_of = |component: &Component| HEADER_LEN + 8 + bodies.len() * component.body_len();
    let components_len: usize = components.iter().map(len_of).sum();
    let [first, second] = order.halves([stamp_us as u32, (stamp_us >> 32) as u32]);
    let mut numbers = |numbers: &[u32]| numbers.iter().for_each(|value| put(&order.put(*value)));
    numbers(&[
        (HEADER_LEN + 16 + components_len) as u32,
        Kind::Data as u32,
        first,
        second,
        number,
        components.len() as u32,
    ]);
    for component in components {
        let len = len_of(component) as u32;
        numbers(&[len, *component as u32, bodies.len() as u32, 0]);
        for body in bodies {
            numbers(&body.position_mm.map(f32::to_bits));
            if *component == Component::EulerAngles {
                numbers(&body.euler_deg().map(f32::to_bits));
            } else {
                numbers(body.axes.map(|axis| axis.map(f32::to_bits)).as_flattened());
            }
            if *component == Component::WithResiduals {
                numbers(&[body.residual_mm.to_bits()]);
            }
        }
    }
}
