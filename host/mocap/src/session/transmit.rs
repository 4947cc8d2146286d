//! What the session does by itself, and when.

use super::Session;
use crate::{
    clock::EchoClock,
    codec::{BitstreamVersion, ClientMessage},
    encode,
    pose_source::Transmit,
};

/// Until the definitions have been read they are requested at this interval; while
/// a body that is needed is not in them, at the longer one.
const UNREAD_MODELS_NS: u64 = 100_000_000;
const INCOMPLETE_MODELS_NS: u64 = 500_000_000;

/// When each message is due next, on the local clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    /// CONNECT, or the bitstream request.
    pub(super) handshake_ns: u64,
    pub(super) bitstream_attempts: u32,
    pub(super) echo_ns: u64,
    pub(super) models_ns: u64,
    /// When the definitions are requested again if they lack a body.
    models_retry_ns: u64,
    pub(super) keep_alive_ns: u64,
    /// Silence counts from here when no frame arrived.
    pub(super) listening_since_ns: u64,
}

impl Schedule {
    /// CONNECT is due at `now_ns`, and nothing else.
    pub(super) fn connect_at(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            ..Self::default()
        }
    }

    /// Every message is due at `now_ns`.
    pub(super) const fn begin(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            bitstream_attempts: 0,
            echo_ns: now_ns,
            models_ns: now_ns,
            models_retry_ns: now_ns,
            keep_alive_ns: now_ns,
            listening_since_ns: now_ns,
        }
    }

    /// The definitions are due at `at_ns` or earlier.
    pub(super) fn models_by(&mut self, at_ns: u64) {
        self.models_ns = self.models_ns.min(at_ns);
    }

    /// The definitions were requested.
    fn models_requested(&mut self, now_ns: u64, poll_ns: u64, have_been_read: bool) {
        let retry_ns = if have_been_read {
            INCOMPLETE_MODELS_NS
        } else {
            UNREAD_MODELS_NS
        };
        self.models_ns = now_ns.saturating_add(retry_ns.min(poll_ns));
    }

    /// The definitions were read: they are due again after the polling interval.
    pub(super) const fn models_read(&mut self, now_ns: u64, poll_ns: u64) {
        self.models_retry_ns = self.models_ns;
        self.models_ns = now_ns.saturating_add(poll_ns);
    }

    /// The definitions that were read lack a body: they are due as if they had not
    /// been read.
    pub(super) const fn models_incomplete(&mut self) {
        self.models_ns = self.models_retry_ns;
    }
}

/// The name that the client introduces itself with.
pub(super) const CLIENT_NAME: &str = "Singletrack";

/// The first exchanges follow each other quickly, so that the clock is soon known.
const QUICK_ECHOES: usize = 8;
const QUICK_ECHO_NS: u64 = 100_000_000;

/// How often the bitstream is requested before the session takes the server's own.
pub(super) const BITSTREAM_ATTEMPTS: u32 = 5;

impl Session {
    /// What is due to be sent while frames arrive.
    pub(super) fn poll_streaming(&mut self, now_ns: u64) -> Option<Transmit> {
        let timing = self.common.config.timing;
        let is_due = |due_ns| now_ns >= due_ns;
        if self.echo_due_ns().is_some_and(is_due) {
            let exchanges = self.clock.echo.as_ref().map_or(0, EchoClock::len);
            let is_quick = exchanges < QUICK_ECHOES;
            let most_ns = if is_quick { QUICK_ECHO_NS } else { u64::MAX };
            let interval_ns = timing.echo_ns.min(most_ns);
            self.schedule.echo_ns = now_ns.saturating_add(interval_ns);
            self.echo_stamp = Some(now_ns);
            let client_stamp = now_ns;
            return self.transmit(&ClientMessage::EchoRequest { client_stamp });
        }
        if now_ns >= self.schedule.models_ns {
            let (poll_ns, are_current) = (timing.model_poll_ns, self.definitions_current);
            self.schedule.models_requested(now_ns, poll_ns, are_current);
            return self.transmit(&ClientMessage::RequestModelDefinitions);
        }
        if self.keep_alive_due_ns().is_some_and(is_due) {
            self.schedule.keep_alive_ns = now_ns.saturating_add(timing.keep_alive_ns);
            return self.transmit(&ClientMessage::KeepAlive);
        }
        None
    }

    pub(super) fn bitstream_request(&self, requested: BitstreamVersion) -> Option<Transmit> {
        let mut text: heapless::String<24> = heapless::String::new();
        // "Bitstream,255.255" fits.
        core::fmt::write(&mut text, format_args!("Bitstream,{requested}")).ok()?;
        self.transmit(&ClientMessage::Request(&text))
    }

    pub(super) fn transmit(&self, message: &ClientMessage<'_>) -> Option<Transmit> {
        let mut bytes = heapless::Vec::new();
        // Every message of a session fits; one that did not would not be sent.
        bytes.resize_default(bytes.capacity()).ok()?;
        let len = encode::client_message(message, &mut bytes).ok()?;
        bytes.truncate(len);
        Some(Transmit {
            destination: self.common.server(),
            on_stream: false,
            bytes,
        })
    }
}
