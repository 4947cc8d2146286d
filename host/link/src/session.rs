//! The session: what it knows, and what its owner may ask of it.

use core::num::NonZeroU32;

use singletrack_protocol::{
    BoardMode, Configuration, ConfigurationError, Decoder, Drive, Frame, Sequence, ToBoard,
};

use crate::clock::BoardClock;
use crate::counters::{BoardQuality, Counters, LineQuality, QualityWindow};
use crate::drive::{self, DriveCommand, DriveError, NewestTelemetry, NotReady};
use crate::event::{Event, LossCause, State};
use crate::handshake::{Greeting, Nonces, Phase};
use crate::latency::{Latency, RoundTrip};
use crate::request::{Pending, Stop, StopKind};

/// What a [`Session`] is made of.
#[derive(Clone, Copy, Debug)]
pub struct SessionConfig {
    /// What the board is given, before anything else.
    pub configuration: Configuration,
    /// The host's software: major, minor, patch. Told to the board.
    pub software_version: [u8; 3],
    /// Seeds the numbers that match answers with greetings. It should differ
    /// from one start of the host to the next; the time of day serves.
    pub nonce_seed: u64,
    /// Rate of the line in baud: the time that a record spends on the wire is
    /// taken off its receive time.
    pub baud: NonZeroU32,
}

/// The session with one board over one port.
///
/// # How to call it
///
/// - Handlers take in what happened, and tell their owner what follows from it
///   as [`Event`]s: [`opened`](Self::opened), [`closed`](Self::closed),
///   [`handle_bytes`](Self::handle_bytes), [`handle_timeout`](Self::handle_timeout).
/// - Requests: [`arm`](Self::arm), [`disarm`](Self::disarm),
///   [`emergency_stop`](Self::emergency_stop), [`configure`](Self::configure);
///   and [`drive`](Self::drive), which hands out its frame at once.
/// - Pollers say what to do next; call them after any handler or request, in
///   this order: [`poll_transmit`](Self::poll_transmit) until it returns
///   `None`, then [`poll_timeout`](Self::poll_timeout).
/// - Getters may be called at any time.
///
/// Hand over the bytes that have arrived before calling
/// [`handle_timeout`](Self::handle_timeout), or a late owner takes its own
/// lateness for a silent board. All times are host nanoseconds on one clock
/// that never runs backwards.
#[derive(Debug)]
pub struct Session {
    pub(crate) config: SessionConfig,
    pub(crate) configuration_hash: u32,
    pub(crate) nonces: Nonces,
    pub(crate) next_request: Sequence,
    pub(crate) decoder: Decoder,
    pub(crate) phase: Phase,
    /// The board has answered since the port was opened, and has said nothing
    /// since of having lost its state.
    pub(crate) acquainted: bool,
    pub(crate) last_heard_ns: u64,
    pub(crate) arm: Option<Pending>,
    pub(crate) stop: Option<Stop>,
    pub(crate) clock: BoardClock,
    pub(crate) last_imu_time_ns: u64,
    pub(crate) newest: Option<NewestTelemetry>,
    pub(crate) last_drive: Sequence,
    pub(crate) latency: Latency,
    pub(crate) counters: Counters,
    pub(crate) quality: QualityWindow,
    pub(crate) board_quality: BoardQuality,
}

impl Session {
    /// A session whose port is closed.
    ///
    /// # Errors
    ///
    /// The value of the configuration that no board would take.
    pub fn new(config: SessionConfig) -> Result<Self, ConfigurationError> {
        config.configuration.validate()?;
        let mut nonces = Nonces(config.nonce_seed);
        let [first_request, first_drive, ..] = nonces.next().to_le_bytes();
        Ok(Self {
            configuration_hash: config.configuration.hash(),
            config,
            nonces,
            next_request: Sequence(first_request),
            decoder: Decoder::new(),
            phase: Phase::Disconnected,
            acquainted: false,
            last_heard_ns: 0,
            arm: None,
            stop: None,
            clock: BoardClock::new(),
            last_imu_time_ns: 0,
            newest: None,
            last_drive: Sequence(first_drive),
            latency: Latency::default(),
            counters: Counters::default(),
            quality: QualityWindow::default(),
            board_quality: BoardQuality::default(),
        })
    }

    // Handlers; those for bytes and time are in `receive.rs` and `transmit.rs`.

    /// The port has been opened (anew): the session begins to greet.
    ///
    /// Bytes of before belong to another connection and must not be handed in
    /// any more.
    pub fn opened(&mut self, now_ns: u64) {
        self.decoder = Decoder::new();
        self.acquainted = false;
        self.greet(now_ns);
    }

    /// The port has been closed or has hung up.
    pub fn closed(&mut self, _now_ns: u64, on_event: &mut impl FnMut(Event)) {
        if matches!(self.phase, Phase::Disconnected) {
            return;
        }
        let connected = self.phase.is_connected();
        self.forget_board();
        self.acquainted = false;
        self.phase = Phase::Disconnected;
        self.counters.hang_ups += 1;
        if connected {
            on_event(Event::Lost {
                cause: LossCause::HangUp,
            });
        }
    }

    // Requests.

    /// Asks the board to arm. Sent up to [`ATTEMPTS`](crate::ATTEMPTS) times;
    /// ends in [`Event::Acknowledged`], [`Event::Refused`] or
    /// [`Event::Unanswered`], unless the link is lost, the board restarts or a
    /// stop is asked for before, which drop it.
    ///
    /// # Errors
    ///
    /// When it cannot be asked now; nothing is kept for later.
    pub fn arm(&mut self, now_ns: u64) -> Result<Sequence, NotReady> {
        if !matches!(self.phase, Phase::Ready) {
            return Err(NotReady::NotConfigured);
        }
        if self.stop.is_some() {
            return Err(NotReady::StopPending);
        }
        if self.arm.is_some() {
            return Err(NotReady::ArmPending);
        }
        let newest = self.newest.ok_or(NotReady::NoTelemetry)?;
        if is_armed(newest.mode) {
            return Err(NotReady::Armed);
        }
        let sequence = self.take_request_number();
        self.arm = Some(Pending::new(sequence, now_ns));
        Ok(sequence)
    }

    /// Asks the board to stop accepting commands. Repeated, over losses and
    /// restarts too, until telemetry shows it: [`Event::StopConfirmed`].
    /// Until then nothing drives or arms.
    ///
    /// An emergency stop that is not yet confirmed stays in its place.
    pub fn disarm(&mut self, now_ns: u64) -> Sequence {
        self.stop(now_ns, StopKind::Disarm)
    }

    /// Asks the board to stop until it is reset; otherwise as
    /// [`disarm`](Self::disarm), whose place it takes.
    pub fn emergency_stop(&mut self, now_ns: u64) -> Sequence {
        self.stop(now_ns, StopKind::EmergencyStop)
    }

    /// Gives the board another configuration, now if it is connected, or when it is.
    ///
    /// # Errors
    ///
    /// When the board is armed or about to be. Nothing is changed.
    pub fn configure(
        &mut self,
        now_ns: u64,
        configuration: Configuration,
    ) -> Result<(), ConfigureError> {
        configuration.validate()?;
        if self.newest.is_some_and(|newest| is_armed(newest.mode)) {
            return Err(NotReady::Armed.into());
        }
        if self.arm.is_some() {
            return Err(NotReady::ArmPending.into());
        }
        self.config.configuration = configuration;
        self.configuration_hash = configuration.hash();
        if self.phase.is_connected() {
            self.phase = Phase::configuring(self.take_request_number(), now_ns);
        }
        Ok(())
    }

    /// The frame of a command, to be written now or never.
    ///
    /// It says how old what it rests on is, so it must not wait: if the port
    /// does not take it whole, drop it and make the next one.
    ///
    /// # Errors
    ///
    /// When the board would not obey, and when a value cannot be sent.
    pub fn drive(&mut self, now_ns: u64, command: DriveCommand) -> Result<Frame, DriveError> {
        if !matches!(self.phase, Phase::Ready) {
            return Err(NotReady::NotConfigured.into());
        }
        if self.stop.is_some() {
            return Err(NotReady::StopPending.into());
        }
        let newest = self.newest.ok_or(NotReady::NoTelemetry)?;
        if !is_armed(newest.mode) {
            return Err(NotReady::NotArmed { mode: newest.mode }.into());
        }
        let sequence = drive::next_sequence(self.last_drive, newest.last_sequence);
        let message: Drive = drive::message(&command, sequence, &newest)?;
        self.last_drive = sequence;
        self.latency.sent(now_ns, sequence);
        self.counters.frames_sent += 1;
        Ok(ToBoard::from(message).encode())
    }

    // Getters.

    /// Where the session stands.
    #[must_use]
    pub fn state(&self) -> State {
        match self.phase {
            Phase::Disconnected => State::Disconnected,
            Phase::Greeting { since_ns, .. } => State::Greeting { since_ns },
            Phase::VersionMismatch { mismatch, .. } => State::VersionMismatch(mismatch),
            Phase::Configuring { refused: None, .. } => State::Configuring,
            Phase::Configuring {
                refused: Some(reason),
                ..
            } => State::ConfigurationRefused { reason },
            Phase::Ready => State::Ready {
                mode: self.newest.map(|newest| newest.mode),
            },
        }
    }

    /// The configuration that the board is given.
    #[must_use]
    pub const fn configuration(&self) -> &Configuration {
        &self.config.configuration
    }

    /// The hash of the configuration that the board is given.
    #[must_use]
    pub const fn configuration_hash(&self) -> u32 {
        self.configuration_hash
    }

    /// Whether a stop waits to be confirmed.
    #[must_use]
    pub const fn is_stop_pending(&self) -> bool {
        self.stop.is_some()
    }

    /// What happened so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Frames from the board over the last second.
    #[must_use]
    pub fn line_quality(&self, now_ns: u64) -> LineQuality {
        self.quality.over_last_second(now_ns)
    }

    /// Frames to the board, as the board counted them over about the last
    /// second; `None` until it has reported twice.
    #[must_use]
    pub const fn board_line_quality(&self) -> Option<LineQuality> {
        self.board_quality.last()
    }

    /// How long commands take to the board and back; `None` before the first
    /// one was seen accepted.
    #[must_use]
    pub fn round_trip(&self) -> Option<RoundTrip> {
        self.latency.round_trip()
    }

    /// The board's clock in host time.
    #[must_use]
    pub const fn clock(&self) -> &BoardClock {
        &self.clock
    }

    // Shared by the handlers.

    fn stop(&mut self, now_ns: u64, kind: StopKind) -> Sequence {
        self.arm = None;
        match self.stop {
            Some(stop) if stop.kind == kind || stop.kind == StopKind::EmergencyStop => {
                stop.sequence
            }
            _ => {
                let sequence = self.take_request_number();
                self.stop = Some(Stop::new(kind, sequence, now_ns));
                sequence
            }
        }
    }

    pub(crate) fn take_request_number(&mut self) -> Sequence {
        let number = self.next_request;
        self.next_request = number.next();
        number
    }

    /// Begins the handshake: whatever was known of the board no longer holds.
    pub(crate) fn greet(&mut self, now_ns: u64) {
        self.forget_board();
        self.phase = Phase::Greeting {
            greeting: Greeting {
                nonce: self.nonces.next(),
                next_ns: now_ns,
            },
            since_ns: now_ns,
        };
    }

    fn forget_board(&mut self) {
        self.arm = None;
        self.newest = None;
        self.clock.restart();
        self.latency.forget_sent();
        self.board_quality = BoardQuality::default();
    }
}

/// Why a new configuration is not taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigureError {
    /// Not in this state.
    #[error(transparent)]
    NotReady(#[from] NotReady),
    /// No board would take it.
    #[error(transparent)]
    Invalid(#[from] ConfigurationError),
}

pub(crate) const fn is_armed(mode: BoardMode) -> bool {
    matches!(mode, BoardMode::Armed | BoardMode::Driving)
}
