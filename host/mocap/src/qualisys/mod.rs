//! The real-time protocol of Qualisys Track Manager (QTM): version 1.13 and later servers.
//!
//! - [`Session`] is a client of one server, over TCP, with frames in datagrams or on TCP, in
//!   either byte order.
//! - [`packet`] turns bytes into packets, and packets into bytes, for both sides.
//!
//! QTM names its bodies in XML ([`BodyList`]) and sends them in that order, in millimetres, with
//! a rotation matrix; a body that is not seen is not a number.

pub mod packet;

use core::fmt::Write as _;

use self::packet::{ByteOrder, FrameBody, Kind, Packet};
use crate::{
    body::{Body, BodyState},
    config::SessionConfig,
    names::Names,
    pose_source::{LocalEnd, Output, SessionEvent},
    stream::{Broken, Dialogue, Incoming, LastFrame, Link, Over, StreamSession, Taken},
};

pub use crate::names::BodyList;

/// A client of a QTM server, without I/O.
pub type Session = StreamSession<QualisysDialogue>;

pub(crate) fn session(config: SessionConfig) -> Session {
    StreamSession::new(config, QualisysDialogue::default())
}

/// The version that is asked for: the newest whose packets are read differently is 1.8.
const VERSION: &str = "Version 1.13";

/// Bodies of a frame that are read.
const BODIES: usize = 64;

/// While no frame comes, the frames are requested again at this interval.
const STREAM_AGAIN_NS: u64 = 1_000_000_000;

/// While the names lack the body, they are requested at this interval.
const NAMES_INCOMPLETE_NS: u64 = 500_000_000;

/// How far the dialogue is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    /// The server greets first.
    #[default]
    Greeting,
    /// The version was asked for.
    Version,
    /// Names and frames are asked for.
    Open,
}

/// The client's side of QTM's protocol.
#[derive(Clone, Debug, Default)]
pub struct QualisysDialogue {
    stage: Stage,
    order: Option<ByteOrder>,
    names_due_ns: u64,
    /// The names are asked for, and nothing else: errors answer this.
    names_asked: bool,
    names_asked_ns: u64,
    stream_due_ns: u64,
    /// How many bodies the names list, and how many the last frame had.
    listed: Option<usize>,
    framed: Option<usize>,
    last: LastFrame,
}

impl QualisysDialogue {
    fn say(&self, text: &str, link: &mut Link) {
        let Some(order) = self.order else {
            return;
        };
        let mut body = heapless::Vec::<u8, 96>::new();
        // The longest request fits.
        let _ = body.extend_from_slice(text.as_bytes());
        let _ = body.push(0);
        let packet = Packet {
            kind: Kind::Command,
            body: &body,
        };
        packet.write(order, &mut |part| link.say(part));
    }

    fn take(
        &mut self,
        order: ByteOrder,
        packet: &Packet<'_>,
        with: &mut Incoming<'_>,
    ) -> Result<(), Broken> {
        let text = || packet.text().unwrap_or_default();
        match (self.stage, packet.kind) {
            // All else comes on the stream, which nobody else can write to.
            (_, kind) if with.over == Over::Datagram && kind != Kind::Data => {
                with.link.common.counters.unsolicited += 1;
            }
            (Stage::Greeting, Kind::Command) if text().starts_with("QTM RT Interface") => {
                self.stage = Stage::Version;
                self.say(VERSION, with.link);
            }
            (Stage::Greeting, _) => return Err(Broken::Foreign),
            (Stage::Version, Kind::Command) if text().starts_with("Version set") => {
                self.stage = Stage::Open;
                (self.names_due_ns, self.stream_due_ns) = (with.now_ns, with.now_ns);
                with.established();
            }
            (Stage::Version, Kind::Command | Kind::Error) => return Err(Broken::Foreign),
            (Stage::Open, Kind::Xml) => {
                self.names_asked = false;
                self.listed(BodyList::new(packet.text_bytes()), with);
            }
            // Without a body QTM has no such settings.
            (Stage::Open, Kind::Error) if self.names_asked => {
                self.names_asked = false;
                self.listed(BodyList::new(b""), with);
            }
            (Stage::Open, Kind::Data) => self.frame(order, packet, with),
            // Settings may have changed.
            (Stage::Open, Kind::Event) => self.names_incomplete(),
            _ => {}
        }
        Ok(())
    }

    fn listed(&mut self, names: BodyList<'_>, with: &mut Incoming<'_>) {
        let count = names.clone().count();
        // A list of other bodies than the frames' is none: it is asked for again.
        let agrees = |framed: usize| framed == count.min(BODIES);
        if self.framed.is_none_or(agrees) {
            self.listed = Some(count);
            (with.on_output)(Output::Names(Names::Listed(names)));
        } else {
            self.names_incomplete();
        }
    }

    fn frame(&mut self, order: ByteOrder, packet: &Packet<'_>, with: &mut Incoming<'_>) {
        let Some(frame) = packet.frame(order) else {
            with.link.common.counters.malformed += 1;
            return;
        };
        self.stream_due_ns = with.now_ns.saturating_add(STREAM_AGAIN_NS);
        let number = frame.number.cast_signed();
        let (link, last) = (&mut *with.link, &mut self.last);
        if !link.is_newest(last, frame.stamp_us, Some(number)) {
            return;
        }
        let mut bodies = heapless::Vec::<Body, BODIES>::new();
        for (id, body) in (0..).zip(frame.bodies()).take(BODIES) {
            let state = state(&body, link);
            // At most as many as there is room for.
            let _ = bodies.push(Body { id, state });
        }
        self.framed = Some(bodies.len());
        // A body was added or removed: the places in the list mean others.
        let differs = |listed: usize| listed.min(BODIES) != bodies.len();
        if self.listed.is_some_and(differs) {
            self.listed = None;
            self.names_incomplete();
            (with.on_output)(Output::Event(SessionEvent::DefinitionsOutdated));
        }
        with.frame(number, frame.stamp_us, &bodies);
    }
}

fn state(body: &FrameBody, link: &Link) -> BodyState {
    let numbers = body.position_mm.iter().chain(body.axes.iter().flatten());
    if numbers.clone().any(|number| number.is_nan()) {
        return BodyState::Untracked;
    }
    let metres = |mm: f32| f64::from(mm) * 1e-3;
    link.common.config.reading().state(
        body.position_mm.map(metres),
        quaternion(body.axes.map(|axis| axis.map(f64::from))),
        metres(body.residual_mm),
    )
}

/// The quaternion x, y, z, w of a rotation whose matrix has these columns; its norm is not one
/// if they are no rotation.
fn quaternion([x, y, z]: [[f64; 3]; 3]) -> [f64; 4] {
    let ([xx, yx, zx], [xy, yy, zy], [xz, yz, zz]) = (x, y, z);
    let trace = xx + yy + zz;
    // The largest component first, so that nothing is divided by a small number.
    let [a, b, c, d] = [
        1.0 + trace,
        1.0 + 2.0 * xx - trace,
        1.0 + 2.0 * yy - trace,
        1.0 + 2.0 * zz - trace,
    ];
    let largest = a.max(b).max(c).max(d);
    let (q, scale) = if a >= largest {
        ([zy - yz, xz - zx, yx - xy, a], a)
    } else if b >= largest {
        ([b, xy + yx, xz + zx, zy - yz], b)
    } else if c >= largest {
        ([xy + yx, c, yz + zy, xz - zx], c)
    } else {
        ([xz + zx, yz + zy, d, yx - xy], d)
    };
    // |q|^2 is 4 scale for a rotation.
    let half = 0.5 / libm::sqrt(scale);
    q.map(|value| value * half)
}

impl Dialogue for QualisysDialogue {
    fn open(&mut self, now_ns: u64, link: &mut Link) {
        let never_ns = now_ns.saturating_add(link.common.config.timing.reconnect_after_ns);
        *self = Self {
            names_due_ns: never_ns,
            stream_due_ns: never_ns,
            ..Self::default()
        };
    }

    fn read(&mut self, bytes: &[u8], with: &mut Incoming<'_>) -> Taken {
        let Some(size) = bytes.first_chunk() else {
            return Ok(None);
        };
        let order = *self.order.get_or_insert(ByteOrder::of(*size));
        match Packet::read(order, bytes) {
            Err(_) if self.stage == Stage::Greeting => Err(Broken::Foreign),
            Err(_) => Err(Broken::NoMessage),
            Ok(None) => Ok(None),
            Ok(Some((packet, length))) => {
                self.take(order, &packet, with)?;
                Ok(Some(length))
            }
        }
    }

    fn poll(&mut self, now_ns: u64, link: &mut Link) {
        if self.stage != Stage::Open {
            return;
        }
        if now_ns >= self.names_due_ns {
            self.names_due_ns = now_ns.saturating_add(link.common.config.timing.model_poll_ns);
            (self.names_asked, self.names_asked_ns) = (true, now_ns);
            self.say("GetParameters 6D", link);
        }
        if now_ns >= self.stream_due_ns {
            self.stream_due_ns = now_ns.saturating_add(STREAM_AGAIN_NS);
            match link.local {
                Some(LocalEnd { datagram_port, .. }) if !link.over_stream => {
                    let mut text = heapless::String::<64>::new();
                    let _ = write!(text, "StreamFrames AllFrames UDP:{datagram_port} 6DRes");
                    self.say(&text, link);
                }
                _ => self.say("StreamFrames AllFrames 6DRes", link),
            }
            // Also a sign of life, where nothing is measured.
            self.names_due_ns = self.names_due_ns.min(self.stream_due_ns);
        }
    }

    fn due_ns(&self) -> u64 {
        self.names_due_ns.min(self.stream_due_ns)
    }

    fn names_incomplete(&mut self) {
        let soon_ns = self.names_asked_ns.saturating_add(NAMES_INCOMPLETE_NS);
        self.names_due_ns = self.names_due_ns.min(soon_ns);
    }
}
