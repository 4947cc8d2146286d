//! What is to be sent when.

use core::net::SocketAddr;

use super::{Datagram, Event, Phase, RestartReason, Session};
use crate::binding::Binding;
use crate::codec::{BitstreamVersion, ClientMessage, Connect};
use crate::config::Transport;
use crate::encode;

/// The name we introduce ourselves with.
const CLIENT_NAME: &str = "Singletrack";

/// The first exchanges come quicker, so that the clock is soon known.
const QUICK_ECHOES: usize = 8;
const QUICK_ECHO_NS: u64 = 100_000_000;

/// Until the definitions have been read they are asked for this often; while
/// they do not list the body, or were asked for again, a little less.
const UNREAD_MODELS_NS: u64 = 100_000_000;
const UNBOUND_MODELS_NS: u64 = 500_000_000;

/// How often the bitstream is requested before the server's own is taken.
const BITSTREAM_ATTEMPTS: u32 = 5;

/// When each message is due next, on the local clock.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Schedule {
    /// CONNECT, or the bitstream request.
    handshake_ns: u64,
    bitstream_attempts: u32,
    echo_ns: u64,
    models_ns: u64,
    keep_alive_ns: u64,
    /// The stream counts as silent from here on when no frame came.
    listening_since_ns: u64,
}

impl Schedule {
    pub(super) fn connect_at(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            ..Self::default()
        }
    }

    /// Everything is due at once.
    pub(super) const fn begin(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            bitstream_attempts: 0,
            echo_ns: now_ns,
            models_ns: now_ns,
            keep_alive_ns: now_ns,
            listening_since_ns: now_ns,
        }
    }

    pub(super) fn models_by(&mut self, at_ns: u64) {
        self.models_ns = self.models_ns.min(at_ns);
    }

    pub(super) const fn models_at(&mut self, at_ns: u64) {
        self.models_ns = at_ns;
    }

    pub(super) const fn handshake_at(&mut self, at_ns: u64) {
        self.handshake_ns = at_ns;
    }
}

impl Session {
    /// The next datagram to send, or `None` when nothing is due at `now_ns`.
    pub fn poll_transmit(&mut self, now_ns: u64) -> Option<Datagram> {
        self.handle_timeouts(now_ns);
        let timing = self.config.timing;
        match self.phase {
            Phase::Closed => None,
            Phase::Closing => {
                self.phase = Phase::Closed;
                self.datagram(&ClientMessage::Disconnect)
            }
            Phase::Connecting | Phase::Refused(_) => {
                if now_ns < self.schedule.handshake_ns {
                    return None;
                }
                self.schedule.handshake_ns = now_ns.saturating_add(timing.retry_ns);
                self.datagram(&ClientMessage::Connect(Connect {
                    name: CLIENT_NAME,
                    // Asked for as a text, which is answered.
                    requested_bitstream: None,
                }))
            }
            Phase::Negotiating(requested) => {
                if now_ns < self.schedule.handshake_ns {
                    return None;
                }
                if self.schedule.bitstream_attempts >= BITSTREAM_ATTEMPTS {
                    self.keep_bitstream(now_ns, requested);
                    return self.poll_streaming(now_ns);
                }
                self.schedule.bitstream_attempts += 1;
                self.schedule.handshake_ns = now_ns.saturating_add(timing.retry_ns);
                self.bitstream_request(requested)
            }
            Phase::Streaming(_) => self.poll_streaming(now_ns),
        }
    }

    fn poll_streaming(&mut self, now_ns: u64) -> Option<Datagram> {
        if !matches!(self.phase, Phase::Streaming(_)) {
            return None;
        }
        let timing = self.config.timing;
        if let Some(due_ns) = self.echo_due_ns()
            && now_ns >= due_ns
        {
            let exchanges = self.clock.echo_mut().map_or(0, |echo| echo.len());
            let interval_ns = if exchanges < QUICK_ECHOES {
                QUICK_ECHO_NS.min(timing.echo_ns)
            } else {
                timing.echo_ns
            };
            self.schedule.echo_ns = now_ns.saturating_add(interval_ns);
            self.echo_stamp = Some(now_ns);
            return self.datagram(&ClientMessage::EchoRequest {
                client_stamp: now_ns,
            });
        }
        if now_ns >= self.schedule.models_ns {
            // The answer puts it off when it binds the body.
            let retry_ns = match self.binding {
                Binding::Unresolved => UNREAD_MODELS_NS,
                _ => UNBOUND_MODELS_NS,
            };
            self.schedule.models_ns = now_ns.saturating_add(retry_ns.min(timing.model_poll_ns));
            return self.datagram(&ClientMessage::RequestModelDefinitions);
        }
        if let Some(due_ns) = self.keep_alive_due_ns()
            && now_ns >= due_ns
        {
            self.schedule.keep_alive_ns = now_ns.saturating_add(timing.keep_alive_ns);
            return self.datagram(&ClientMessage::KeepAlive);
        }
        None
    }

    /// When [`poll_transmit`](Self::poll_transmit) has something to do next.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<u64> {
        match self.phase {
            Phase::Closed => None,
            Phase::Closing => Some(0),
            Phase::Connecting | Phase::Refused(_) | Phase::Negotiating(_) => {
                let stale_ns = self.stale_due_ns().unwrap_or(u64::MAX);
                Some(self.schedule.handshake_ns.min(stale_ns))
            }
            Phase::Streaming(_) => [
                Some(self.schedule.models_ns),
                self.echo_due_ns(),
                self.keep_alive_due_ns(),
                self.stale_due_ns(),
                Some(self.silence_due_ns()),
            ]
            .into_iter()
            .flatten()
            .min(),
        }
    }

    fn handle_timeouts(&mut self, now_ns: u64) {
        if self.stale_due_ns().is_some_and(|due_ns| now_ns >= due_ns) {
            self.stale = true;
            self.counters.stale += 1;
            self.event(Event::Stale);
        }
        if matches!(self.phase, Phase::Streaming(_)) && now_ns >= self.silence_due_ns() {
            self.restart(now_ns, RestartReason::Silence);
        }
    }

    /// Servers before 3.0 have no echo, and tell no frequency.
    fn echo_due_ns(&self) -> Option<u64> {
        let connection = self.server?.connection?;
        connection.ticks_per_second.map(|_| self.schedule.echo_ns)
    }

    fn keep_alive_due_ns(&self) -> Option<u64> {
        matches!(self.config.transport, Transport::Unicast { .. })
            .then_some(self.schedule.keep_alive_ns)
    }

    fn stale_due_ns(&self) -> Option<u64> {
        if self.stale {
            return None;
        }
        // Stale is what is silent for longer than the limit.
        let limit_ns = self.config.timing.stale_after_ns.saturating_add(1);
        Some(self.last_frame_ns?.saturating_add(limit_ns))
    }

    fn silence_due_ns(&self) -> u64 {
        self.decodable_until_ns()
            .saturating_add(self.config.timing.reconnect_after_ns)
    }

    /// When a frame last came that could be decoded, or the first was waited for.
    pub(super) fn decodable_until_ns(&self) -> u64 {
        self.last_frame_ns
            .unwrap_or_default()
            .max(self.schedule.listening_since_ns)
    }

    fn bitstream_request(&self, requested: BitstreamVersion) -> Option<Datagram> {
        let mut text: heapless::String<24> = heapless::String::new();
        // "Bitstream,255.255" fits.
        core::fmt::write(&mut text, format_args!("Bitstream,{requested}")).ok()?;
        self.datagram(&ClientMessage::Request(&text))
    }

    fn datagram(&self, message: &ClientMessage<'_>) -> Option<Datagram> {
        let mut datagram = Datagram {
            destination: SocketAddr::new(self.config.server, self.config.command_port),
            bytes: heapless::Vec::new(),
        };
        // Every message of a session fits; if one ever does not, it is not sent.
        datagram
            .bytes
            .resize_default(datagram.bytes.capacity())
            .ok()?;
        let len = encode::client_message(message, &mut datagram.bytes).ok()?;
        datagram.bytes.truncate(len);
        Some(datagram)
    }
}
