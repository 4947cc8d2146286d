//! What a session knows, what its owner may ask of it, and what it sends by itself, and when.

use core::num::NonZeroU32;

use singletrack_protocol::{
    Arm, BoardMode, Configuration, ConfigurationError, Configure, Decoder, Drive, Frame, Hello,
    Jog, MAX_FRAME_LENGTH, Request, Sequence, ToBoard, VERSION,
};

use crate::{
    clock::BoardClock,
    drive::{
        self, DriveCommand, DriveError, JogCommand, Latency, NewestTelemetry, NotReady, RoundTrip,
    },
    event::{BoardQuality, Counters, Event, LineQuality, LossCause, QualityWindow, State},
    handshake::{
        Greeting, HELLO_INTERVAL_NS, Nonces, Pending, Phase, SLOW_RETRY_NS, Stop, StopKind,
    },
};

/// The board is lost when no good frame has arrived from it for this long, in
/// nanoseconds.
pub const LINK_TIMEOUT_NS: u64 = 200_000_000;

/// The configuration of a [`Session`].
#[derive(Clone, Copy, Debug)]
pub struct SessionConfig {
    /// The board's configuration, which it is given first.
    pub configuration: Configuration,
    /// The host's software: major, minor, patch. It is sent to the board.
    pub software_version: [u8; 3],
    /// Seed of the numbers that match answers with greetings. It should differ from
    /// one start of the host to the next; the time of day is good enough.
    pub nonce_seed: u64,
    /// Rate of the line in baud: the time that a record spends on the wire is
    /// subtracted from its receive time.
    pub baud: NonZeroU32,
}

/// The session with one board over one port.
///
/// [The crate's documentation](crate) describes how to call it. The inputs are
/// [`handle_opened`](Self::handle_opened), [`handle_closed`](Self::handle_closed) and
/// [`handle_bytes`](Self::handle_bytes). All times are nanoseconds of one host clock
/// that never runs backwards.
#[derive(Clone, Debug)]
pub struct Session {
    pub(crate) config: SessionConfig,
    pub(crate) configuration_hash: u32,
    pub(crate) nonces: Nonces,
    pub(crate) next_request: Sequence,
    pub(crate) decoder: Decoder,
    pub(crate) phase: Phase,
    /// The board has answered since the port was opened, and has not reported since
    /// that it lost its state.
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
    /// The value of the configuration that every board would refuse.
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
            clock: BoardClock::default(),
            last_imu_time_ns: 0,
            newest: None,
            last_drive: Sequence(first_drive),
            latency: Latency::default(),
            counters: Counters::default(),
            quality: QualityWindow::default(),
            board_quality: BoardQuality::default(),
        })
    }

    // Handlers; those for bytes are in `receive.rs`, those for time below.

    /// The port has been opened, for the first time or again: the session begins to
    /// greet.
    ///
    /// Bytes that were received before belong to another connection: do not hand them
    /// over any more.
    pub fn handle_opened(&mut self, now_ns: u64) {
        self.decoder = Decoder::new();
        self.acquainted = false;
        self.greet(now_ns);
    }

    /// The port has been closed or has hung up.
    pub fn handle_closed(&mut self, _now_ns: u64, on_event: &mut impl FnMut(Event)) {
        if matches!(self.phase, Phase::Disconnected) {
            return;
        }
        let connected = self.phase.is_connected();
        self.forget_board();
        self.acquainted = false;
        self.phase = Phase::Disconnected;
        self.counters.hang_ups += 1;
        if connected {
            let cause = LossCause::HangUp;
            on_event(Event::Lost { cause });
        }
    }

    // Requests.

    /// Asks the board to arm. The request is sent up to
    /// [`ATTEMPTS`](crate::ATTEMPTS) times. It ends in [`Event::Acknowledged`],
    /// [`Event::Refused`] or [`Event::Unanswered`]. A lost link, a restart of the board
    /// or a request to stop drops it without an event.
    ///
    /// # Errors
    ///
    /// The board can't be asked now. Nothing is kept for later.
    pub fn arm(&mut self, now_ns: u64) -> Result<Sequence, NotReady> {
        self.takes_commands()?;
        if self.arm.is_some() {
            return Err(NotReady::ArmPending);
        }
        let newest = self.newest.ok_or(NotReady::NoTelemetry)?;
        if newest.mode.is_armed() {
            return Err(NotReady::Armed);
        }
        let sequence = self.take_request_number();
        self.arm = Some(Pending::new(sequence, now_ns));
        Ok(sequence)
    }

    /// Asks the board to stop accepting commands. The request is repeated, also over
    /// losses and restarts, until telemetry shows its effect
    /// ([`Event::StopConfirmed`]). Until then the session neither drives nor arms.
    ///
    /// It does not replace an emergency stop that is not confirmed yet.
    pub fn disarm(&mut self, now_ns: u64) -> Sequence {
        self.stop(now_ns, StopKind::Disarm)
    }

    /// Asks the board to stop until it is reset; otherwise as
    /// [`disarm`](Self::disarm), which it replaces.
    pub fn emergency_stop(&mut self, now_ns: u64) -> Sequence {
        self.stop(now_ns, StopKind::EmergencyStop)
    }

    /// Gives the board another configuration: now if it is connected, otherwise once
    /// it is.
    ///
    /// # Errors
    ///
    /// The board is armed or a request to arm is pending, or the configuration is not
    /// valid. Nothing is changed.
    pub fn configure(
        &mut self,
        now_ns: u64,
        configuration: Configuration,
    ) -> Result<(), ConfigureError> {
        configuration.validate()?;
        if self.newest.is_some_and(|newest| newest.mode.is_armed()) {
            return Err(NotReady::Armed.into());
        }
        if self.arm.is_some() {
            return Err(NotReady::ArmPending.into());
        }
        self.config.configuration = configuration;
        self.configuration_hash = configuration.hash();
        if self.phase.is_connected() {
            self.phase = Phase::configuring(self.take_request_number(), now_ns, None);
        }
        Ok(())
    }

    /// The frame of a command, to be written at once.
    ///
    /// The frame carries the age of its inputs, so it must not wait: if the port does
    /// not take all of it, drop it and make the next one.
    ///
    /// # Errors
    ///
    /// The board would not obey, or a value can't be sent.
    pub fn drive(&mut self, now_ns: u64, command: DriveCommand) -> Result<Frame, DriveError> {
        let (sequence, newest) = self.next_command(BoardMode::Driving)?;
        let message: Drive = drive::message(&command, sequence, &newest)?;
        Ok(self.command(now_ns, sequence, message.into()))
    }

    /// The frame of bare pulses, to be written at once as that of a
    /// [drive](Self::drive). From [`BoardMode::Armed`] the first command decides: a
    /// board that jogs takes no drive, and one that drives no pulses.
    ///
    /// # Errors
    ///
    /// The board would not obey.
    pub fn jog(&mut self, now_ns: u64, command: JogCommand) -> Result<Frame, NotReady> {
        let (sequence, newest) = self.next_command(BoardMode::Jogging)?;
        let message = Jog {
            sequence,
            telemetry_time_us: newest.board_time_us,
            servo_us: command.servo_us,
            esc_us: command.esc_us,
        };
        Ok(self.command(now_ns, sequence, message.into()))
    }

    /// Whether the board may be asked to drive.
    fn takes_commands(&self) -> Result<(), NotReady> {
        if !matches!(self.phase, Phase::Ready) {
            return Err(NotReady::NotConfigured);
        }
        match self.stop {
            Some(_) => Err(NotReady::StopPending),
            None => Ok(()),
        }
    }

    /// Number and telemetry of a command that leads to `mode`.
    fn next_command(&self, mode: BoardMode) -> Result<(Sequence, NewestTelemetry), NotReady> {
        self.takes_commands()?;
        let newest = self.newest.ok_or(NotReady::NoTelemetry)?;
        if newest.mode != BoardMode::Armed && newest.mode != mode {
            return Err(NotReady::NotArmed { mode: newest.mode });
        }
        let sequence = drive::next_sequence(self.last_drive, newest.last_sequence);
        Ok((sequence, newest))
    }

    fn command(&mut self, now_ns: u64, sequence: Sequence, message: ToBoard) -> Frame {
        self.last_drive = sequence;
        self.latency.sent(now_ns, sequence);
        self.counters.frames_sent += 1;
        message.encode()
    }

    // Getters.

    /// How far the session is.
    pub fn state(&self) -> State {
        match self.phase {
            Phase::Disconnected => State::Disconnected,
            Phase::Greeting(greeting) => match greeting.mismatch {
                Some(mismatch) => State::VersionMismatch(mismatch),
                None => State::Greeting {
                    since_ns: greeting.since_ns,
                },
            },
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
    pub const fn configuration(&self) -> &Configuration {
        &self.config.configuration
    }

    /// The hash of the configuration that the board is given.
    pub const fn configuration_hash(&self) -> u32 {
        self.configuration_hash
    }

    /// Whether a stop is not confirmed yet.
    pub const fn is_stop_pending(&self) -> bool {
        self.stop.is_some()
    }

    /// What was counted so far.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Frames from the board over the last second.
    pub fn line_quality(&self, now_ns: u64) -> LineQuality {
        self.quality.over_last_second(now_ns)
    }

    /// Frames to the board, as the board counted them over about the last
    /// second; `None` until it has reported twice.
    pub const fn board_line_quality(&self) -> Option<LineQuality> {
        self.board_quality.last
    }

    /// How long commands take to the board and back; `None` until telemetry reports
    /// the first accepted one.
    pub fn round_trip(&self) -> Option<RoundTrip> {
        self.latency.round_trip
    }

    /// The board's clock in host time.
    pub const fn clock(&self) -> &BoardClock {
        &self.clock
    }

    // Shared by the handlers.

    fn stop(&mut self, now_ns: u64, kind: StopKind) -> Sequence {
        self.arm = None;
        if let Some(stop) = self.stop
            && (stop.kind == kind || stop.kind == StopKind::EmergencyStop)
        {
            return stop.sequence;
        }
        let sequence = self.take_request_number();
        self.stop = Some(Stop::new(kind, sequence, now_ns));
        sequence
    }

    pub(crate) fn take_request_number(&mut self) -> Sequence {
        let number = self.next_request;
        self.next_request = number.next();
        number
    }

    /// Begins the handshake: nothing that was known of the board is valid any more.
    pub(crate) fn greet(&mut self, now_ns: u64) {
        self.forget_board();
        self.phase = Phase::Greeting(Greeting {
            nonce: self.nonces.next(),
            since_ns: now_ns,
            next_ns: now_ns,
            answered: None,
            mismatch: None,
        });
    }

    fn forget_board(&mut self) {
        self.arm = None;
        self.newest = None;
        self.clock.restart();
        self.latency.forget_sent();
        self.board_quality = BoardQuality::default();
    }
}

/// Why a new configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigureError {
    /// Not in this state.
    #[error(transparent)]
    NotReady(#[from] NotReady),
    /// Every board would refuse it.
    #[error(transparent)]
    Invalid(#[from] ConfigurationError),
}

/// Bytes to be written whole or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transmit(heapless::Vec<u8, { MAX_FRAME_LENGTH + 1 }>);

impl Transmit {
    /// The bytes.
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
        let message = self
            .due_stop(now_ns)
            .or_else(|| self.due_handshake(now_ns))
            .or_else(|| self.due_arm(now_ns))?;
        self.counters.frames_sent += 1;
        // A zero ends a frame that the board has received in part.
        let zero = matches!(message, ToBoard::Hello(_)).then_some(0);
        let frame = message.encode();
        let bytes = zero.into_iter().chain(frame.as_bytes().iter().copied());
        Some(Transmit(bytes.collect()))
    }

    /// When [`handle_timeout`](Self::handle_timeout) and
    /// [`poll_transmit`](Self::poll_transmit) must be called next, in host
    /// nanoseconds; `None` while the port is closed.
    pub fn poll_timeout(&self) -> Option<u64> {
        let handshake = match &self.phase {
            Phase::Disconnected => return None,
            Phase::Greeting(greeting) => Some(greeting.next_ns),
            Phase::Configuring { pending, .. } => Some(pending.next_ns),
            Phase::Ready => None,
        };
        let stop = self.stop.filter(|_| self.may_send_stop());
        let stop = stop.map(|stop| stop.next_ns);
        let arm = self.arm.map(|arm| arm.next_ns);
        let silent_ns = self.last_heard_ns.saturating_add(LINK_TIMEOUT_NS);
        let silence = self.phase.is_connected().then_some(silent_ns);
        [handshake, stop, arm, silence].into_iter().flatten().min()
    }

    /// Acts on silence: a board that sends nothing, a request without an answer.
    ///
    /// Hand over the bytes that have arrived before.
    pub fn handle_timeout(&mut self, now_ns: u64, on_event: &mut impl FnMut(Event)) {
        if self.phase.is_connected() && now_ns.saturating_sub(self.last_heard_ns) >= LINK_TIMEOUT_NS
        {
            self.counters.links_lost += 1;
            let cause = LossCause::Silence;
            on_event(Event::Lost { cause });
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
        let greets = matches!(self.phase, Phase::Greeting(_));
        self.phase.is_connected() || (self.acquainted && greets)
    }

    fn due_stop(&mut self, now_ns: u64) -> Option<ToBoard> {
        if !self.may_send_stop() {
            return None;
        }
        self.stop.as_mut()?.take_due(now_ns)
    }

    fn due_handshake(&mut self, now_ns: u64) -> Option<ToBoard> {
        if let Some(greeting) = self.phase.greeting_mut() {
            if now_ns < greeting.next_ns {
                return None;
            }
            let mismatch = greeting.mismatch;
            let interval_ns = mismatch.map_or(HELLO_INTERVAL_NS, |_| SLOW_RETRY_NS);
            greeting.next_ns = now_ns.saturating_add(interval_ns);
            let hello = Hello {
                protocol_version: VERSION,
                software_version: self.config.software_version,
                nonce: greeting.nonce,
            };
            return Some(hello.into());
        }
        if let Phase::Configuring { pending, .. } = &mut self.phase
            && pending.take_due(now_ns)
        {
            let configure = Configure {
                request: pending.sequence,
                configuration: self.config.configuration,
            };
            return Some(configure.into());
        }
        None
    }

    fn due_arm(&mut self, now_ns: u64) -> Option<ToBoard> {
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
        Some(message.into())
    }
}
