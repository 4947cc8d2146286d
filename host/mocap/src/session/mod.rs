//! One client's conversation with one server.
//!
//! The shell around it owns socket and clock, and for every wake-up calls
//!
//! 1. [`Session::handle_datagram`] for every datagram waiting, oldest first;
//! 2. [`Session::poll_transmit`] until it returns `None`, sending each datagram;
//! 3. [`Session::poll_event`] until it returns `None`, for the log;
//! 4. [`Session::poll_timeout`], to know how long it may sleep.
//!
//! Steps 2 to 4 are due at the time of step 4 even when nothing arrived: silence
//! is noticed in step 2. Observations of the body come from step 1; [`Session::pose_state`] tells at any
//! time what is known, silence included.

mod event;
mod frames;
mod replies;
mod schedule;

pub use event::{Connected, Datagram, Event, Observation, Outcome, Phase, RestartReason};

use core::net::SocketAddr;

use crate::binding::Binding;
use crate::clock::CaptureClock;
use crate::codec::{
    BitstreamVersion, Connection, DecodeError, MessageId, Packet, ServerMessage, UnsupportedVersion,
};
use crate::config::{Config, ConfigError};
use crate::counters::Counters;
use crate::gate::Gate;
use crate::order::Sequence;
use crate::pose::PoseState;
use schedule::Schedule;

/// Events kept for the shell to fetch.
const EVENTS: usize = 16;

/// So many frames in a row that cannot be decoded, for as long as a stream may be
/// silent, are another bitstream.
const UNDECODABLE: u32 = 20;

/// A NatNet client, without socket and clock.
#[derive(Debug, Clone)]
pub struct Session {
    config: Config,
    phase: Phase,
    schedule: Schedule,
    binding: Binding,
    /// The server's own bitstream and connection, once it said so.
    server: Option<Server>,
    clock: CaptureClock,
    /// Stamp of the echo request not yet answered.
    echo_stamp: Option<u64>,
    sequence: Sequence,
    gate: Gate,
    state: PoseState,
    last_frame_ns: Option<u64>,
    stale: bool,
    models_changed: bool,
    undecodable: u32,
    counters: Counters,
    events: heapless::Deque<Event, EVENTS>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Server {
    natnet_version: [u8; 4],
    native: Result<BitstreamVersion, UnsupportedVersion>,
    connection: Option<Connection>,
}

impl Session {
    /// A session that begins with the first [`poll_transmit`](Self::poll_transmit).
    ///
    /// # Errors
    /// The configuration makes no sense.
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            phase: Phase::Connecting,
            schedule: Schedule::default(),
            binding: Binding::Unresolved,
            server: None,
            clock: CaptureClock::new(None, &config.timing),
            echo_stamp: None,
            sequence: Sequence::default(),
            gate: Gate::new(config.limits),
            state: PoseState::NoFrames,
            last_frame_ns: None,
            stale: false,
            models_changed: false,
            undecodable: 0,
            counters: Counters::default(),
            events: heapless::Deque::new(),
            config,
        })
    }

    /// Takes a datagram that arrived at `now_ns` from `source`.
    pub fn handle_datagram(&mut self, now_ns: u64, source: SocketAddr, datagram: &[u8]) -> Outcome {
        // Frames come from the command port or the data port, replies from the
        // command port, multicast from anywhere: only the address is checked.
        if source.ip() != self.config.server {
            self.counters.wrong_source += 1;
            return Outcome::WrongSource;
        }
        let is_frame = Packet::parse(datagram)
            .is_ok_and(|packet| packet.message_id() == Some(MessageId::Frame));
        let version = match self.phase {
            Phase::Streaming(version) => version,
            _ if is_frame => {
                self.counters.early += 1;
                return Outcome::Ignored;
            }
            // Nothing but frames and definitions depends on it.
            _ => BitstreamVersion::NEWEST,
        };
        match ServerMessage::decode(datagram, version) {
            Ok(ServerMessage::Frame(frame)) => {
                self.undecodable = 0;
                self.handle_frame(now_ns, &frame)
            }
            Ok(reply) => self.handle_reply(now_ns, &reply),
            Err(error) => self.handle_malformed(now_ns, is_frame, error),
        }
    }

    fn handle_malformed(&mut self, now_ns: u64, is_frame: bool, error: DecodeError) -> Outcome {
        self.counters.malformed += 1;
        if is_frame {
            self.undecodable = self.undecodable.saturating_add(1);
            // As long as others can be decoded these are not another bitstream but
            // somebody's rubbish; and whoever sends it quickly must not have the
            // conversation begin anew all the time.
            let lasts_ns = now_ns.saturating_sub(self.decodable_until_ns());
            if self.undecodable >= UNDECODABLE && lasts_ns >= self.config.timing.stale_after_ns {
                self.restart(now_ns, RestartReason::Undecodable(error));
            }
        }
        Outcome::Malformed(error)
    }

    /// What is known of the body at `now_ns`.
    #[must_use]
    pub fn pose_state(&self, now_ns: u64) -> PoseState {
        match self.last_frame_ns.map(|last| now_ns.saturating_sub(last)) {
            Some(silent_ns) if silent_ns > self.config.timing.stale_after_ns => {
                PoseState::Stale { silent_ns }
            }
            _ => self.state,
        }
    }

    /// How far the conversation is.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Which streaming id the configured name has.
    #[must_use]
    pub const fn binding(&self) -> Binding {
        self.binding
    }

    /// What happened so far.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The configuration the session runs with.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// The next thing worth a line in the log.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Leaves the server: [`poll_transmit`](Self::poll_transmit) yields a goodbye
    /// and then nothing more.
    pub const fn close(&mut self) {
        self.phase = Phase::Closing;
    }

    fn event(&mut self, event: Event) {
        if self.events.is_full() {
            self.events.pop_front();
            self.counters.events_dropped += 1;
        }
        // Room was made above.
        let _ = self.events.push_back(event);
    }

    /// Begins the conversation anew. What is known of the body's motion stays:
    /// it still bounds where the body can be.
    fn restart(&mut self, now_ns: u64, reason: RestartReason) {
        if matches!(self.phase, Phase::Closing | Phase::Closed) {
            return;
        }
        self.counters.restarts += 1;
        self.phase = Phase::Connecting;
        self.schedule = Schedule::connect_at(now_ns);
        self.server = None;
        self.echo_stamp = None;
        self.undecodable = 0;
        self.models_changed = false;
        self.set_binding(Binding::Unresolved);
        self.event(Event::Restarted(reason));
    }

    fn set_binding(&mut self, binding: Binding) {
        if self.binding != binding {
            self.binding = binding;
            self.event(Event::Binding(binding));
        }
    }
}
