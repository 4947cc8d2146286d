//! A session over a stream, with frames on the stream or as datagrams.
//!
//! [`StreamSession`] keeps the stream open, notices silence, puts frames in order and finds when
//! they were captured ([`Link`]). What is said on the stream is the protocol's own
//! ([`Dialogue`]).

use core::net::SocketAddr;

use crate::{
    body::{Bodies, BodiesOf, Body, CaptureTime},
    clock::{EchoSample, SampleUse, StampClock},
    codec::FrameFlags,
    config::{SessionConfig, Transport},
    pose_source::{
        Common, Input, LocalEnd, MAX_LEN, Output, Phase, PoseFrame, PoseSource, RestartReason,
        SessionEvent, Stream, Transmit, Wake,
    },
};

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

/// If no datagram arrives for this time, frames are requested over the stream.
const DATAGRAMS_WITHIN_NS: u64 = 1_500_000_000;

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

/// A client of a server that is reached over a stream, without I/O.
///
/// Its owner keeps the stream of [`PoseSource::stream`] open and reports what happens to it
/// ([`Input`]).
#[derive(Clone, Debug)]
pub struct StreamSession<D> {
    link: Link,
    dialogue: D,
}

impl<D: Dialogue> StreamSession<D> {
    pub(crate) fn new(config: SessionConfig, dialogue: D) -> Self {
        Self {
            link: Link::new(config),
            dialogue,
        }
    }

    fn opened(&mut self, now_ns: u64, local: LocalEnd) {
        self.link.local = Some(local);
        self.link.since_ns = now_ns;
        self.link.heard_ns = now_ns;
        self.dialogue.open(now_ns, &mut self.link);
    }

    /// Reads messages until none is complete; returns how many bytes were used.
    fn stream(&mut self, bytes: &[u8], wake: &mut Wake<'_>) -> usize {
        let mut used = 0;
        while let Some(rest) = bytes.get(used..).filter(|rest| !rest.is_empty()) {
            if self.link.local.is_none() {
                return bytes.len();
            }
            match self.read(rest, Over::Stream, wake) {
                Ok(Some(length)) => {
                    used += length.max(1);
                    self.link.heard_ns = wake.now_ns;
                }
                Ok(None) => break,
                Err(broken) => {
                    self.broken(broken, wake);
                    return bytes.len();
                }
            }
        }
        used.min(bytes.len())
    }

    fn read(&mut self, bytes: &[u8], over: Over, wake: &mut Wake<'_>) -> Taken {
        let mut with = Incoming {
            now_ns: wake.now_ns,
            over,
            link: &mut self.link,
            on_output: wake.on_output,
        };
        self.dialogue.read(bytes, &mut with)
    }

    fn broken(&mut self, broken: Broken, wake: &mut Wake<'_>) {
        let link = &mut self.link;
        link.common.counters.malformed += 1;
        match broken {
            Broken::NoMessage => link.restart(RestartReason::StreamBroken, wake),
            Broken::Foreign => {
                // An answer that comes again is reported once.
                if !matches!(link.common.phase, Phase::Foreign) {
                    link.common.phase = Phase::Foreign;
                    wake.tell(SessionEvent::Foreign);
                }
                link.let_go(wake.now_ns, link.common.config.timing.retry_ns);
            }
        }
    }

    fn datagram(&mut self, source: SocketAddr, bytes: &[u8], wake: &mut Wake<'_>) {
        let link = &mut self.link;
        if !link.common.is_server(source.ip(), wake) {
            return;
        }
        // A server sends from one port.
        let (counters, port) = (&mut link.common.counters, source.port());
        if link.datagram_port.is_some_and(|known| known != port) {
            counters.wrong_source += 1;
            return;
        }
        if link.common.phase != Phase::Open {
            counters.early += 1;
            return;
        }
        let frames = counters.frames;
        let mut rest = bytes;
        while !rest.is_empty() && self.link.local.is_some() {
            let Ok(Some(length)) = self.read(rest, Over::Datagram, wake) else {
                self.link.common.counters.malformed += 1;
                return;
            };
            rest = rest.get(length.max(1)..).unwrap_or_default();
        }
        // What is no frame must not keep the server's port out.
        if self.link.common.counters.frames > frames {
            self.link.datagram_port = Some(port);
        }
        self.link.datagram_ns = Some(wake.now_ns);
        self.link.heard_ns = wake.now_ns;
    }

    /// When the owner's stream, or the server behind it, has been silent for too long.
    fn silence_due_ns(&self) -> u64 {
        let link = &self.link;
        let since_ns = link.since_ns.max(link.heard_ns);
        since_ns.saturating_add(link.common.config.timing.reconnect_after_ns)
    }

    /// When it is clear that no datagram arrives, or none any more. Nobody may be seen, too: then
    /// the stream is as good.
    fn datagrams_due_ns(&self) -> Option<u64> {
        let link = &self.link;
        // A server may send its frames over the stream by itself.
        let heard_ns = link.datagram_ns.or(link.common.last_frame_ns);
        let since_ns = link.since_ns.max(heard_ns.unwrap_or_default());
        (link.common.phase == Phase::Open && !link.over_stream)
            .then_some(since_ns.saturating_add(DATAGRAMS_WITHIN_NS))
    }
}

impl<D: Dialogue> PoseSource for StreamSession<D> {
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        if self.link.common.is_closing() {
            return 0;
        }
        let wake = &mut Wake { now_ns, on_output };
        match input {
            Input::Datagram { source, bytes } => self.datagram(source, bytes, wake),
            Input::Stream(bytes) => return self.stream(bytes, wake),
            _ if !self.link.is_wanted => {}
            Input::Opened(local) => self.opened(now_ns, local),
            Input::Closed => self.link.restart(RestartReason::StreamEnded, wake),
        }
        0
    }

    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        if self.link.common.is_closing() {
            return;
        }
        let wake = &mut Wake { now_ns, on_output };
        self.link.common.notice_silence(wake);
        let is_silent = now_ns >= self.silence_due_ns();
        let datagrams_due_ns = self.datagrams_due_ns();
        let link = &mut self.link;
        if !link.is_wanted {
            if now_ns >= link.retry_ns {
                link.is_wanted = true;
                link.attempt = link.attempt.wrapping_add(1);
                link.since_ns = now_ns;
            }
        } else if is_silent && link.local.is_some() && link.common.phase != Phase::Open {
            // The server has not shown that it speaks the protocol.
            self.broken(Broken::Foreign, wake);
        } else if is_silent {
            link.over_stream = link.common.config.transport == Transport::Stream;
            link.fell_back = false;
            link.restart(RestartReason::Silence, wake);
        } else if datagrams_due_ns.is_some_and(|due_ns| now_ns >= due_ns) {
            link.over_stream = true;
            link.fell_back = true;
            link.restart(RestartReason::NoDatagrams, wake);
        }
    }

    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        if self.link.common.phase == Phase::Closing {
            self.link.common.phase = Phase::Closed;
        }
        if self.link.common.phase == Phase::Closed || self.link.local.is_none() {
            return None;
        }
        self.dialogue.poll(now_ns, &mut self.link);
        let mut bytes = heapless::Vec::new();
        while bytes.len() < MAX_LEN
            && let Some(byte) = self.link.outgoing.pop_front()
        {
            // There is room: see above.
            let _ = bytes.push(byte);
        }
        (!bytes.is_empty()).then(|| Transmit {
            destination: self.link.common.server(),
            on_stream: true,
            bytes,
        })
    }

    fn poll_timeout(&self) -> Option<u64> {
        let link = &self.link;
        match link.common.phase {
            Phase::Closed => return None,
            Phase::Closing => return Some(0),
            _ => {}
        }
        let (silence_ns, retry_ns) = (self.silence_due_ns(), link.retry_ns);
        let wake_ns = if link.is_wanted { silence_ns } else { retry_ns };
        let says_ns = link.local.map(|_| self.dialogue.due_ns());
        let (stale_ns, datagrams_ns) = (link.common.stale_due_ns(), self.datagrams_due_ns());
        let due_ns = [Some(wake_ns), says_ns, stale_ns, datagrams_ns];
        due_ns.into_iter().flatten().min()
    }

    fn stream(&self) -> Option<Stream> {
        let is_open = !self.link.common.is_closing();
        (is_open && self.link.is_wanted).then(|| Stream {
            server: self.link.common.server(),
            attempt: self.link.attempt,
        })
    }

    fn request_names_again(&mut self) {
        self.dialogue.names_incomplete();
    }

    fn common(&self) -> &Common {
        &self.link.common
    }

    fn common_mut(&mut self) -> &mut Common {
        &mut self.link.common
    }
}
