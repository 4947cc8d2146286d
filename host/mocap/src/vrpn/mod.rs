//! VRPN: trackers of Vicon, of cheap cameras with markers, and of many others.
//!
//! - [`Session`] is a client of one server, over TCP, with poses in datagrams or on TCP.
//! - [`message`] turns bytes into messages, and messages into bytes, for both sides.
//!
//! A body is a sensor of a tracker. VRPN has no frames and no sign of a body that is not seen:
//! the server repeats an old pose, sends zeros, or nothing.

pub mod message;

use core::fmt::Write as _;

use self::message::{
    COOKIE, COOKIE_BEGINNING, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION,
    TYPE_DESCRIPTION, UDP_DESCRIPTION, description,
};
use crate::{
    body::{Body, BodyState},
    clock::EchoSample,
    config::SessionConfig,
    names::{CONTROL, NAME_LEN, Names, SenderName, body_id},
    pose_source::Output,
    stream::{Broken, Dialogue, Incoming, LastFrame, Link, Over, StreamSession, Taken},
};

pub use crate::names::Senders;

/// A client of a VRPN server, without I/O.
pub type Session = StreamSession<VrpnDialogue>;

/// A session that follows a sensor of the tracker `body`, or all bodies.
pub(crate) fn session(config: SessionConfig, sensor: i32, body: Option<&str>) -> Session {
    StreamSession::new(config, VrpnDialogue::new(sensor, body))
}

/// The client's own numbers of its sender and its types.
const OUR_SENDER: i32 = 0;
const OUR_PING: i32 = 0;
const OUR_PONG: i32 = 1;

/// The first exchanges follow each other quickly, so that the clock is soon known.
const QUICK_PINGS: usize = 8;
const QUICK_PING_NS: u64 = 100_000_000;

/// A ping that is not answered for this time will not be; an answer that takes longer than the
/// other tells too little of the clock.
const ANSWER_WITHIN_NS: u64 = 1_000_000_000;
const QUICK_ANSWER_NS: u64 = 250_000_000;

/// How many bodies are remembered.
const BODIES: usize = 24;

/// A body that was not reported for longer is not where it was.
const RECENT_NS: u64 = 200_000_000;

/// The client's side of VRPN.
#[derive(Clone, Debug)]
pub struct VrpnDialogue {
    /// The tracker that is followed; without one, all are.
    follow: Option<SenderName>,
    sensor: i32,
    welcomed: bool,
    /// The sender has been described in whose name pings are sent.
    introduced: bool,
    senders: Senders,
    /// The server's numbers of types.
    pose: Option<i32>,
    ping: Option<i32>,
    pong: Option<i32>,
    bodies: heapless::Vec<Known, BODIES>,
    /// When the ping was sent that waits for its answer.
    ping_sent_ns: Option<u64>,
    ping_due_ns: u64,
    ping_every_ns: u64,
    number: i32,
    sequence: u32,
}

/// What was reported of a body.
#[derive(Clone, Copy, Debug)]
struct Known {
    body: Body,
    last: LastFrame,
    at_ns: u64,
}

impl VrpnDialogue {
    fn new(sensor: i32, body: Option<&str>) -> Self {
        Self {
            follow: body.map(|name| SenderName::try_from(name.as_bytes()).unwrap_or_default()),
            sensor,
            welcomed: false,
            introduced: false,
            senders: Senders::new(sensor),
            pose: None,
            ping: None,
            pong: None,
            bodies: heapless::Vec::new(),
            ping_sent_ns: None,
            ping_due_ns: 0,
            ping_every_ns: 0,
            number: 0,
            sequence: 0,
        }
    }

    fn say(&mut self, now_ns: u64, sender: i32, kind: i32, body: &[u8], link: &mut Link) {
        let message = Message {
            // A server does not look at it.
            stamp_us: now_ns / 1_000,
            sender,
            kind,
            body,
        };
        let mut bytes = heapless::Vec::<u8, { NAME_LEN + 64 }>::new();
        message.write(self.sequence, &mut |part| {
            let _ = bytes.extend_from_slice(part);
        });
        self.sequence = self.sequence.wrapping_add(1);
        link.say(&bytes);
    }

    /// After the cookies: who asks, what is asked, and where datagrams are expected.
    fn introduce(&mut self, now_ns: u64, link: &mut Link) {
        if !link.over_stream
            && let Some(local) = link.local
        {
            let mut host = heapless::String::<48>::new();
            // An address fits.
            let _ = write!(host, "{}\0", local.address);
            let port = i32::from(local.datagram_port);
            self.say(now_ns, port, UDP_DESCRIPTION, host.as_bytes(), link);
        }
        for (number, name) in [(OUR_PING, PING), (OUR_PONG, PONG)] {
            self.say(now_ns, number, TYPE_DESCRIPTION, &description(name), link);
        }
        if let Some(name) = self.follow.clone() {
            self.ask_as(now_ns, &name, link);
        }
        self.ping_due_ns = now_ns;
        self.ping_every_ns = link.common.config.timing.echo_ns;
    }

    /// The server's object of this name answers pings.
    fn ask_as(&mut self, now_ns: u64, name: &[u8], link: &mut Link) {
        self.introduced = true;
        let body = description(name);
        self.say(now_ns, OUR_SENDER, SENDER_DESCRIPTION, &body, link);
    }

    fn take(&mut self, message: &Message<'_>, with: &mut Incoming<'_>) {
        let (link, now_ns) = (&mut *with.link, with.now_ns);
        let kind = Some(message.kind);
        match message.kind {
            // Names and clock come on the stream, which nobody else can write to.
            _ if with.over == Over::Datagram && kind != self.pose => {
                link.common.counters.unsolicited += 1;
            }
            SENDER_DESCRIPTION | TYPE_DESCRIPTION => {
                let Some(name) = message.described() else {
                    link.common.counters.malformed += 1;
                    return;
                };
                if message.kind == TYPE_DESCRIPTION {
                    self.describe_type(message.sender, name);
                } else if self
                    .senders
                    .describe(message.sender, name, self.follow.as_deref())
                {
                    if !self.introduced && name != CONTROL {
                        self.ask_as(now_ns, name, link);
                    }
                    (with.on_output)(Output::Names(Names::Senders(&self.senders)));
                }
            }
            _ if kind == self.pose => match message.pose() {
                Some(pose) => self.pose(message, &pose, with),
                None => link.common.counters.malformed += 1,
            },
            _ if kind == self.pong => {
                let sent_ns = self.ping_sent_ns.take();
                let is_quick = |sent_ns: &u64| now_ns.saturating_sub(*sent_ns) <= QUICK_ANSWER_NS;
                if let Some(sent_ns) = sent_ns.filter(is_quick) {
                    link.exchanged(EchoSample {
                        sent_ns,
                        received_ns: now_ns,
                        server_ticks: message.stamp_us,
                    });
                } else {
                    link.common.counters.unsolicited += 1;
                }
            }
            _ if kind == self.ping => self.say(now_ns, OUR_SENDER, OUR_PONG, &[], link),
            // Texts, buttons, velocities: nobody needs them.
            _ => {}
        }
    }

    /// Takes the server's number of a type; the same number may have meant another.
    fn describe_type(&mut self, number: i32, name: &[u8]) {
        for (known, wanted) in [
            (&mut self.pose, POSE),
            (&mut self.ping, PING),
            (&mut self.pong, PONG),
        ] {
            if name == wanted.as_bytes() {
                *known = Some(number);
            } else if *known == Some(number) {
                *known = None;
            }
        }
    }

    fn pose(&mut self, message: &Message<'_>, pose: &Pose, with: &mut Incoming<'_>) {
        let (link, now_ns) = (&mut *with.link, with.now_ns);
        let Some(name) = self.senders.name(message.sender) else {
            link.common.counters.early += 1;
            return;
        };
        let is_followed = match &self.follow {
            Some(follow) => follow == name && pose.sensor == self.sensor,
            None => true,
        };
        let id = body_id(message.sender, pose.sensor);
        let index = match self.bodies.iter().position(|known| known.body.id == id) {
            Some(index) => index,
            // Others can do without a place, the followed body can't.
            None if self.bodies.is_full() && !is_followed => return,
            None => {
                if self.bodies.is_full() {
                    self.bodies.pop();
                }
                let (state, last, at_ns) = (BodyState::Untracked, LastFrame::default(), now_ns);
                let body = Body { id, state };
                // There is room: see above.
                let _ = self.bodies.push(Known { body, last, at_ns });
                self.bodies.len() - 1
            }
        };
        let Some(known) = self.bodies.get_mut(index) else {
            return;
        };
        if !link.is_newest(&mut known.last, message.stamp_us, None) {
            return;
        }
        known.body.state = state(pose, link);
        known.at_ns = now_ns;
        if !is_followed {
            return;
        }
        self.number = self.number.wrapping_add(1);
        let frame: heapless::Vec<Body, BODIES> = self
            .bodies
            .iter()
            .filter(|known| match self.follow {
                Some(_) => now_ns.saturating_sub(known.at_ns) <= RECENT_NS,
                None => known.body.id == id,
            })
            .map(|known| known.body)
            .collect();
        with.frame(self.number, message.stamp_us, &frame);
    }
}

/// A body's state. Zeros are what servers send of a body that they have not seen.
fn state(pose: &Pose, link: &Link) -> BodyState {
    let (position_m, [x, y, z, _]) = (pose.position_m, pose.orientation_xyzw);
    if position_m == [0.0; 3] && [x, y, z] == [0.0; 3] {
        return BodyState::Untracked;
    }
    let reading = link.common.config.reading();
    reading.state(position_m, pose.orientation_xyzw, 0.0)
}

impl Dialogue for VrpnDialogue {
    fn open(&mut self, now_ns: u64, link: &mut Link) {
        *self = Self {
            follow: self.follow.take(),
            number: self.number,
            ..Self::new(self.sensor, None)
        };
        self.ping_due_ns = now_ns.saturating_add(link.common.config.timing.reconnect_after_ns);
        link.say(&COOKIE);
    }

    fn read(&mut self, bytes: &[u8], with: &mut Incoming<'_>) -> Taken {
        if !self.welcomed {
            let seen = bytes.len().min(COOKIE_BEGINNING.len());
            if bytes.get(..seen) != COOKIE_BEGINNING.get(..seen) {
                return Err(Broken::Foreign);
            }
            if bytes.len() < COOKIE.len() {
                return Ok(None);
            }
            self.welcomed = true;
            with.established();
            self.introduce(with.now_ns, with.link);
            return Ok(Some(COOKIE.len()));
        }
        let Some((message, length)) = Message::read(bytes).map_err(|_| Broken::NoMessage)? else {
            return Ok(None);
        };
        self.take(&message, with);
        Ok(Some(length))
    }

    fn poll(&mut self, now_ns: u64, link: &mut Link) {
        if !self.welcomed || now_ns < self.ping_due_ns {
            return;
        }
        if !self.introduced {
            self.ping_due_ns = now_ns.saturating_add(QUICK_PING_NS);
            return;
        }
        let is_quick = link.exchanges() < QUICK_PINGS;
        let most_ns = if is_quick { QUICK_PING_NS } else { u64::MAX };
        let every_ns = self.ping_every_ns.min(most_ns);
        self.ping_due_ns = now_ns.saturating_add(every_ns.max(1));
        // An answer has no number: one ping at a time, or the next could take its answer. An object
        // that was made since may answer the next.
        let is_lost = |sent_ns: u64| now_ns.saturating_sub(sent_ns) >= ANSWER_WITHIN_NS;
        if self.ping_sent_ns.is_none_or(is_lost) {
            self.ping_sent_ns = Some(now_ns);
            self.say(now_ns, OUR_SENDER, OUR_PING, &[], link);
        }
    }

    fn due_ns(&self) -> u64 {
        self.ping_due_ns
    }
}
