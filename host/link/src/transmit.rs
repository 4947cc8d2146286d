//! What the session does by itself, and when.

use singletrack_protocol::{
    Arm, Configure, Frame, Hello, MAX_FRAME_LENGTH, Request, ToBoard, VERSION,
};

use crate::{
    event::{Event, LossCause},
    handshake::{HELLO_INTERVAL_NS, Phase, SLOW_RETRY_NS},
    session::Session,
};

/// The board is lost when no good frame has arrived from it for this long, in
/// nanoseconds.
pub const LINK_TIMEOUT_NS: u64 = 200_000_000;

/// Bytes to be written whole or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transmit(heapless::Vec<u8, { MAX_FRAME_LENGTH + 1 }>);

impl Transmit {
    fn frame(frame: &Frame) -> Self {
        Self(frame.as_bytes().iter().copied().collect())
    }

    /// The frame after a zero, which ends a frame that the board has received in part.
    fn after_zero(frame: &Frame) -> Self {
        Self(
            core::iter::once(0)
                .chain(frame.as_bytes().iter().copied())
                .collect(),
        )
    }

    /// The bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

impl Session {
    /// The next bytes to write now; call it until it returns `None`.
    ///
    /// What the port does not take may be dropped: the session repeats what
    /// matters. At most three frames are due at a time, however late the call: a stop,
    /// a greeting or configuration, and a request to arm.
    pub fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        let transmit = self
            .due_stop(now_ns)
            .or_else(|| self.due_handshake(now_ns))
            .or_else(|| self.due_arm(now_ns))?;
        self.counters.frames_sent += 1;
        Some(transmit)
    }

    /// When [`handle_timeout`](Self::handle_timeout) and
    /// [`poll_transmit`](Self::poll_transmit) must be called next, in host
    /// nanoseconds; `None` while the port is closed.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<u64> {
        let handshake = match &self.phase {
            Phase::Disconnected => return None,
            Phase::Greeting { greeting, .. } | Phase::VersionMismatch { greeting, .. } => {
                Some(greeting.next_ns)
            }
            Phase::Configuring { pending, .. } => Some(pending.deadline_ns()),
            Phase::Ready => None,
        };
        let stop = self
            .stop
            .filter(|_| self.may_send_stop())
            .map(|stop| stop.deadline_ns());
        let arm = self.arm.map(|arm| arm.deadline_ns());
        let silence = self
            .phase
            .is_connected()
            .then(|| self.last_heard_ns.saturating_add(LINK_TIMEOUT_NS));
        [handshake, stop, arm, silence].into_iter().flatten().min()
    }

    /// Acts on silence: a board that sends nothing, a request without an answer.
    ///
    /// Hand over the bytes that have arrived before.
    pub fn handle_timeout(&mut self, now_ns: u64, on_event: &mut impl FnMut(Event)) {
        if self.phase.is_connected() && now_ns.saturating_sub(self.last_heard_ns) >= LINK_TIMEOUT_NS
        {
            self.counters.links_lost += 1;
            on_event(Event::Lost {
                cause: LossCause::Silence,
            });
            self.greet(now_ns);
            return;
        }
        if let Phase::Configuring { pending, .. } = self.phase
            && pending.is_exhausted(now_ns)
        {
            self.counters.requests_unanswered += 1;
            on_event(Event::Unanswered {
                request: Request::Configure,
                sequence: pending.sequence,
            });
            self.greet(now_ns);
        }
        if let Some(arm) = self.arm.take_if(|arm| arm.is_exhausted(now_ns)) {
            self.counters.requests_unanswered += 1;
            on_event(Event::Unanswered {
                request: Request::Arm,
                sequence: arm.sequence,
            });
        }
    }

    /// A stop is sent whenever the board may understand it, even while the board is
    /// silent, but not to a board that may speak another version.
    fn may_send_stop(&self) -> bool {
        self.phase.is_connected() || (self.acquainted && self.phase.greeting().is_some())
    }

    fn due_stop(&mut self, now_ns: u64) -> Option<Transmit> {
        if !self.may_send_stop() {
            return None;
        }
        let message = self.stop.as_mut()?.take_due(now_ns)?;
        Some(Transmit::frame(&message.encode()))
    }

    fn due_handshake(&mut self, now_ns: u64) -> Option<Transmit> {
        let interval_ns = match self.phase {
            Phase::VersionMismatch { .. } => SLOW_RETRY_NS,
            _ => HELLO_INTERVAL_NS,
        };
        if let Some(greeting) = self.phase.greeting_mut() {
            if now_ns < greeting.next_ns {
                return None;
            }
            greeting.next_ns = now_ns.saturating_add(interval_ns);
            let hello = Hello {
                protocol_version: VERSION,
                software_version: self.config.software_version,
                nonce: greeting.nonce,
            };
            return Some(Transmit::after_zero(&ToBoard::from(hello).encode()));
        }
        if let Phase::Configuring { pending, .. } = &mut self.phase
            && pending.take_due(now_ns)
        {
            let configure = Configure {
                request: pending.sequence,
                configuration: self.config.configuration,
            };
            return Some(Transmit::frame(&ToBoard::from(configure).encode()));
        }
        None
    }

    fn due_arm(&mut self, now_ns: u64) -> Option<Transmit> {
        let newest = self.newest?;
        let arm = self.arm.as_mut()?;
        if !arm.take_due(now_ns) {
            return None;
        }
        let message = Arm {
            request: arm.sequence,
            configuration_hash: self.configuration_hash,
            telemetry_time_us: newest.board_time_us,
        };
        Some(Transmit::frame(&ToBoard::from(message).encode()))
    }
}
