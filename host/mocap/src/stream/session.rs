//! Keeps a stream open and hands what arrives to the dialogue.

use core::net::SocketAddr;

use super::{Broken, Dialogue, Incoming, Link, Over, Taken};
use crate::{
    config::{SessionConfig, Transport},
    pose_source::{
        Common, Input, LocalEnd, MAX_LEN, Output, Phase, PoseSource, RestartReason, SessionEvent,
        Stream, Transmit, Wake,
    },
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
                // The same answer again is reported once.
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
