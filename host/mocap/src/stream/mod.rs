//! A session over a stream, with frames on the stream or as datagrams.
//!
//! [`StreamSession`] keeps the stream open, notices silence, puts frames in order and finds when
//! they were captured ([`Link`]). What is said on the stream is the protocol's own
//! ([`Dialogue`]).

mod session;

use crate::{
    body::{Bodies, BodiesOf, Body, CaptureTime},
    clock::{EchoSample, SampleUse, StampClock},
    codec::FrameFlags,
    config::{SessionConfig, Transport},
    pose_source::{Common, LocalEnd, Output, Phase, PoseFrame, RestartReason, SessionEvent, Wake},
};

pub use session::StreamSession;

/// How a message arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    /// On the stream.
    Stream,
    /// In a datagram.
    Datagram,
}

/// What a protocol needs with the bytes of a message.
pub struct Incoming<'a> {
    /// When they arrived, on the local clock.
    pub(crate) now_ns: u64,
    pub(crate) over: Over,
    pub(crate) link: &'a mut Link,
    /// Takes what is said to the owner.
    pub(crate) on_output: &'a mut dyn FnMut(Output<'_>),
}

/// Why a stream can't go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Broken {
    /// The bytes are no message.
    NoMessage,
    /// The server speaks another protocol, or a version that is not supported.
    Foreign,
}

/// How many bytes a message took; none of one that is not complete.
pub(crate) type Taken = Result<Option<usize>, Broken>;

/// The longest message that is taken from a stream.
pub(crate) const LONGEST: usize = 1 << 20;

/// What a protocol says and understands.
pub trait Dialogue {
    /// The stream is open; nothing of an earlier one is valid.
    fn open(&mut self, now_ns: u64, link: &mut Link);

    /// Reads the first message of `bytes`, and returns its length; none if it is not complete.
    ///
    /// # Errors
    /// The stream can't go on.
    fn read(&mut self, bytes: &[u8], with: &mut Incoming<'_>) -> Taken;

    /// Says what is due.
    fn poll(&mut self, now_ns: u64, link: &mut Link);

    /// When something is to be said next.
    fn due_ns(&self) -> u64;

    /// The names lack the body that is needed.
    fn names_incomplete(&mut self) {}
}

/// This number of frames in a row that are older than the newest means that the server's clock
/// was set back.
const SET_BACK: u32 = 10;

/// Numbers that are farther ahead are those of another stream.
const RESTARTED: i32 = 10_000;

/// A capture time whose error can be larger is none, in ns.
const MAX_UNCERTAINTY_NS: u64 = 1_000_000_000;

/// Frames over the stream so soon after it was asked for them show that they did not arrive
/// otherwise, in ns.
const EVIDENCE_NS: u64 = 1_000_000_000;

/// The newest frame of a body or of all bodies.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LastFrame {
    newest: Option<(u64, i32)>,
    older: u32,
}

impl Incoming<'_> {
    /// Passes a frame on.
    pub(crate) fn frame(&mut self, number: i32, stamp_us: u64, bodies: &[Body]) {
        let (link, now_ns) = (&mut *self.link, self.now_ns);
        if core::mem::take(&mut link.fell_back)
            && self.over == Over::Stream
            && now_ns.saturating_sub(link.since_ns) <= EVIDENCE_NS
        {
            (self.on_output)(Output::Event(SessionEvent::DatagramsBlocked));
        }
        link.common.frame(now_ns);
        let capture = link.capture(stamp_us, now_ns);
        (self.on_output)(Output::Frame(PoseFrame {
            number,
            receive_time_ns: now_ns,
            capture,
            flags: FrameFlags::default(),
            definitions_current: true,
            bodies: Bodies {
                of: BodiesOf::List(bodies.iter()),
                up_axis: link.common.config.up_axis,
            },
        }));
    }

    /// The server speaks the protocol.
    pub(crate) fn established(&mut self) {
        self.link.common.phase = Phase::Open;
        (self.on_output)(Output::Event(SessionEvent::Opened));
    }
}

/// The state of the stream and of the frames.
#[derive(Clone, Debug)]
pub struct Link {
    pub(crate) common: Common,
    attempt: u32,
    /// Whether the owner is to keep the stream open.
    is_wanted: bool,
    /// When it is wanted again.
    retry_ns: u64,
    /// The owner's end, while the stream is open.
    pub(crate) local: Option<LocalEnd>,
    /// When the session began to wait for the stream, or when it opened.
    since_ns: u64,
    /// When the server was heard last.
    heard_ns: u64,
    outgoing: heapless::Deque<u8, 1_024>,
    /// Frames are requested over the stream, now or for good.
    pub(crate) over_stream: bool,
    /// That is so because no datagram arrived, and was not reported yet.
    fell_back: bool,
    /// When the last good datagram arrived since the stream is open.
    datagram_ns: Option<u64>,
    datagram_port: Option<u16>,
    clock: StampClock,
}

impl Link {
    fn new(config: SessionConfig) -> Self {
        Self {
            attempt: 0,
            is_wanted: false,
            retry_ns: 0,
            local: None,
            since_ns: 0,
            heard_ns: 0,
            outgoing: heapless::Deque::new(),
            over_stream: config.transport == Transport::Stream,
            fell_back: false,
            datagram_ns: None,
            datagram_port: None,
            clock: StampClock::new(&config.timing),
            common: Common::new(config),
        }
    }

    /// Queues bytes for the stream. What a dialogue says at a time fits; a server that asks
    /// without end loses answers.
    pub(crate) fn say(&mut self, bytes: &[u8]) {
        if self.outgoing.capacity() - self.outgoing.len() >= bytes.len() {
            for byte in bytes {
                let _ = self.outgoing.push_back(*byte);
            }
        }
    }

    /// The number of exchanges that are in use.
    pub(crate) const fn exchanges(&self) -> usize {
        self.clock.echo.len()
    }

    /// The server's clock showed a stamp, in its ticks, between two local times.
    pub(crate) fn exchanged(&mut self, sample: EchoSample) {
        let used = self.clock.echo.add(sample);
        if used == SampleUse::Backward {
            self.clock = StampClock::new(&self.common.config.timing);
            let _ = self.clock.echo.add(sample);
        }
        self.common.counters.clock_steps += u64::from(used != SampleUse::Agreed);
        self.common.counters.echoes += 1;
    }

    /// Whether a frame is newer than the last one. Without numbers none counts as lost.
    pub(crate) fn is_newest(
        &mut self,
        last: &mut LastFrame,
        stamp_us: u64,
        number: Option<i32>,
    ) -> bool {
        let number_now = number.unwrap_or_default();
        if let Some((newest_us, number_before)) = last.newest {
            if stamp_us == newest_us {
                self.common.counters.duplicates += 1;
                return false;
            }
            let ahead = number.map(|number| number.wrapping_sub(number_before));
            if stamp_us < newest_us {
                last.older += 1;
                // The next number with an older stamp is no late frame.
                let is_set_back = ahead.is_some_and(|ahead| (1..RESTARTED).contains(&ahead));
                if !is_set_back && last.older < SET_BACK {
                    self.common.counters.late += 1;
                    return false;
                }
                self.common.counters.clock_steps += 1;
                self.clock = StampClock::new(&self.common.config.timing);
            }
            let lost = ahead.filter(|ahead| (1..RESTARTED).contains(ahead));
            self.common.counters.lost += u64::from(lost.unwrap_or(1).unsigned_abs() - 1);
        }
        last.newest = Some((stamp_us, number_now));
        last.older = 0;
        true
    }

    /// When the frame was captured: never after it arrived.
    fn capture(&mut self, stamp_us: u64, now_ns: u64) -> Option<CaptureTime> {
        let capture = self.clock.capture(stamp_us, now_ns)?;
        if capture.uncertainty_ns > MAX_UNCERTAINTY_NS {
            return None;
        }
        self.common.at_arrival(capture, now_ns)
    }

    /// Lets go of the stream; it is wanted again after `pause_ns`.
    fn let_go(&mut self, now_ns: u64, pause_ns: u64) {
        self.is_wanted = false;
        self.retry_ns = now_ns.saturating_add(pause_ns);
        self.local = None;
        self.outgoing.clear();
        self.datagram_port = None;
        self.datagram_ns = None;
        self.clock = StampClock::new(&self.common.config.timing);
        if !matches!(self.common.phase, Phase::Foreign) {
            self.common.phase = Phase::Connecting;
        }
    }

    /// Starts over.
    fn restart(&mut self, reason: RestartReason, wake: &mut Wake<'_>) {
        let pause_ns = match reason {
            // The next moment at which the owner looks.
            RestartReason::NoDatagrams => 1_000_000,
            _ => self.common.config.timing.retry_ns,
        };
        // A server that is not there is no news.
        let is_news = self.local.is_some();
        self.let_go(wake.now_ns, pause_ns);
        if is_news {
            self.common.counters.restarts += 1;
            wake.tell(SessionEvent::DefinitionsOutdated);
            wake.tell(SessionEvent::Restarted(reason));
        }
    }
}
