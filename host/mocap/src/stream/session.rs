//! Keeps a stream open and hands what arrives to the dialogue.

use core::net::IpAddr;

use super::{Broken, Dialogue, Incoming, Link, Over};
use crate::{
    config::{SessionConfig, Transport},
    pose_source::{Input, LocalEnd, Output, PoseSource, Stream},
    session::{MAX_LEN, Phase, RestartReason, SessionCounters, SessionEvent, Transmit},
};

/// If no datagram arrives for this time, frames are requested over the stream.
const DATAGRAMS_WITHIN_NS: u64 = 1_500_000_000;

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
        if !self.link.is_wanted {
            return;
        }
        self.link.local = Some(local);
        self.link.since_ns = now_ns;
        self.link.heard_ns = now_ns;
        self.dialogue.open(now_ns, &mut self.link);
    }

    fn closed(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        if self.link.is_wanted {
            self.link
                .restart(now_ns, RestartReason::StreamEnded, on_output);
        }
    }

    /// Reads messages until none is complete; returns how many bytes were used.
    fn stream(
        &mut self,
        now_ns: u64,
        bytes: &[u8],
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        let mut used = 0;
        while let Some(rest) = bytes.get(used..).filter(|rest| !rest.is_empty()) {
            if self.link.local.is_none() {
                return bytes.len();
            }
            match self.read(now_ns, rest, Over::Stream, on_output) {
                Ok(Some(length)) => {
                    used += length.max(1);
                    self.link.heard_ns = now_ns;
                }
                Ok(None) => break,
                Err(broken) => {
                    self.broken(now_ns, broken, on_output);
                    return bytes.len();
                }
            }
        }
        used.min(bytes.len())
    }

    fn read(
        &mut self,
        now_ns: u64,
        bytes: &[u8],
        over: Over,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> Result<Option<usize>, Broken> {
        let mut with = Incoming {
            now_ns,
            over,
            link: &mut self.link,
            on_output,
        };
        self.dialogue.read(bytes, &mut with)
    }

    fn broken(&mut self, now_ns: u64, broken: Broken, on_output: &mut dyn FnMut(Output<'_>)) {
        self.link.counters.malformed += 1;
        match broken {
            Broken::NoMessage => self
                .link
                .restart(now_ns, RestartReason::StreamBroken, on_output),
            Broken::Foreign => {
                // The same answer again is reported once.
                if !matches!(self.link.phase, Phase::Foreign) {
                    self.link.phase = Phase::Foreign;
                    on_output(Output::Event(SessionEvent::Foreign));
                }
                self.link.let_go(now_ns, self.link.config.timing.retry_ns);
            }
        }
    }

    fn datagram(
        &mut self,
        now_ns: u64,
        (address, port): (IpAddr, u16),
        bytes: &[u8],
        on_output: &mut dyn FnMut(Output<'_>),
    ) {
        let link = &mut self.link;
        // A server sends from one port.
        if address != link.config.server || link.datagram_port.is_some_and(|known| known != port) {
            link.counters.wrong_source += 1;
            if address != link.config.server {
                link.other_source = Some(address);
                let is_news = !link.other_sources.contains(&address);
                if is_news && link.other_sources.push(address).is_ok() {
                    on_output(Output::Event(SessionEvent::OtherSource(address)));
                }
            }
            return;
        }
        if link.phase != Phase::Open {
            link.counters.early += 1;
            return;
        }
        let frames = link.counters.frames;
        let mut rest = bytes;
        while !rest.is_empty() && self.link.local.is_some() {
            let Ok(Some(length)) = self.read(now_ns, rest, Over::Datagram, on_output) else {
                self.link.counters.malformed += 1;
                return;
            };
            rest = rest.get(length.max(1)..).unwrap_or_default();
        }
        // What is no frame must not keep the server's port out.
        if self.link.counters.frames > frames {
            self.link.datagram_port = Some(port);
        }
        self.link.datagram_ns = Some(now_ns);
        self.link.heard_ns = now_ns;
    }

    /// When the owner's stream, or the server behind it, has been silent for too long.
    fn silence_due_ns(&self) -> u64 {
        self.link
            .since_ns
            .max(self.link.heard_ns)
            .saturating_add(self.link.config.timing.reconnect_after_ns)
    }

    /// When it is clear that no datagram arrives, or none any more. Nobody may be seen, too: then
    /// the stream is as good.
    fn datagrams_due_ns(&self) -> Option<u64> {
        let link = &self.link;
        // A server may send its frames over the stream by itself.
        let heard_ns = link.datagram_ns.or(link.last_frame_ns).unwrap_or_default();
        (link.phase == Phase::Open && !link.over_stream).then_some(
            link.since_ns
                .max(heard_ns)
                .saturating_add(DATAGRAMS_WITHIN_NS),
        )
    }
}

impl<D: Dialogue> PoseSource for StreamSession<D> {
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        if matches!(self.link.phase, Phase::Closing | Phase::Closed) {
            return 0;
        }
        match input {
            Input::Datagram { source, bytes } => {
                self.datagram(now_ns, (source.ip(), source.port()), bytes, on_output);
            }
            Input::Opened(local) => self.opened(now_ns, local),
            Input::Stream(bytes) => return self.stream(now_ns, bytes, on_output),
            Input::Closed => self.closed(now_ns, on_output),
        }
        0
    }

    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        if matches!(self.link.phase, Phase::Closing | Phase::Closed) {
            return;
        }
        if self
            .link
            .stale_due_ns()
            .is_some_and(|due_ns| now_ns >= due_ns)
        {
            self.link.is_stale = true;
            self.link.counters.stale += 1;
            on_output(Output::Event(SessionEvent::Stale));
        }
        if !self.link.is_wanted {
            if now_ns >= self.link.retry_ns {
                self.link.is_wanted = true;
                self.link.attempt = self.link.attempt.wrapping_add(1);
                self.link.since_ns = now_ns;
            }
        } else if now_ns >= self.silence_due_ns() && self.link.is_mute() {
            self.broken(now_ns, Broken::Foreign, on_output);
        } else if now_ns >= self.silence_due_ns() {
            self.link.over_stream = self.link.config.transport == Transport::Stream;
            self.link.fell_back = false;
            self.link.restart(now_ns, RestartReason::Silence, on_output);
        } else if self
            .datagrams_due_ns()
            .is_some_and(|due_ns| now_ns >= due_ns)
        {
            self.link.over_stream = true;
            self.link.fell_back = true;
            self.link
                .restart(now_ns, RestartReason::NoDatagrams, on_output);
        }
    }

    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        if self.link.phase == Phase::Closing {
            self.link.phase = Phase::Closed;
        }
        if self.link.phase == Phase::Closed || self.link.local.is_none() {
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
            destination: self.link.server(),
            on_stream: true,
            bytes,
        })
    }

    fn poll_timeout(&self) -> Option<u64> {
        let link = &self.link;
        match link.phase {
            Phase::Closed => return None,
            Phase::Closing => return Some(0),
            _ => {}
        }
        let wake_ns = if link.is_wanted {
            self.silence_due_ns()
        } else {
            link.retry_ns
        };
        let says_ns = link.local.map(|_| self.dialogue.due_ns());
        [
            Some(wake_ns),
            says_ns,
            link.stale_due_ns(),
            self.datagrams_due_ns(),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    fn stream(&self) -> Option<Stream> {
        let is_open = !matches!(self.link.phase, Phase::Closing | Phase::Closed);
        (is_open && self.link.is_wanted).then(|| Stream {
            server: self.link.server(),
            attempt: self.link.attempt,
        })
    }

    fn request_names_again(&mut self) {
        self.dialogue.names_incomplete();
    }

    fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.link.config.timing.stamp_offset_ns = offset_ns;
    }

    fn close(&mut self) {
        self.link.phase = Phase::Closing;
    }

    fn phase(&self) -> Phase {
        self.link.phase
    }

    fn stale_for_ns(&self, now_ns: u64) -> Option<u64> {
        self.link
            .last_frame_ns
            .map(|last_ns| now_ns.saturating_sub(last_ns))
            .filter(|silent_ns| *silent_ns > self.link.config.timing.stale_after_ns)
    }

    fn other_source(&self) -> Option<IpAddr> {
        self.link.other_source
    }

    fn counters(&self) -> SessionCounters {
        self.link.counters
    }
}
