//! Board, host, cameras, operator, car and line: the state that is explored. The wheels turn while
//! the ESC drives, and roll out; the line carries whole frames, in order, each of them lost, late
//! or twice.

use singletrack_board::{Board, ImuSample, Inputs, MotorPulses, Outputs};
use singletrack_control::Time;
use singletrack_core::Config;
use singletrack_link::SessionConfig;
use singletrack_pilot::{Arming, Event as PilotEvent, Mode, PilotRequest, SupervisorConfig};
use singletrack_protocol::{
    BoardMode, Configuration, Decoder, Frame, Packet, ResetCause, ToBoard, ToHost,
};

use crate::{
    action::{Action, Event, Passage},
    claim::{Claims, Ended, Facts, Planted, Violation, Wish},
    host::{Host, Seen},
};

/// A control tick, and a poll of the board.
const TICK_NS: u64 = 10_000_000;

const SOFTWARE: [u8; 3] = [0, 1, 0];

/// Seeds of sessions: those of two that follow each other differ.
const SEEDS: u64 = 3;

/// What is believed of the car.
#[derive(Clone, Debug)]
pub struct Setting {
    pub(crate) session: SessionConfig,
    pub(crate) supervisor: SupervisorConfig,
    /// The board's configurations, between which the operator changes.
    pub(crate) configurations: [Configuration; 2],
    /// A mistake that must be found.
    pub planted: Option<Planted>,
}

impl Setting {
    /// That of a configuration file, with another neutral as the other one.
    ///
    /// # Errors
    ///
    /// A configuration that is not valid.
    pub fn of(config: &Config) -> Result<Self, String> {
        let session = config.link(0);
        let mut other = session.configuration;
        other.esc.neutral_us += 10;
        other.validate().map_err(|error| error.to_string())?;
        let supervisor = config
            .pilot()
            .map_err(|error| error.to_string())?
            .supervisor;
        Ok(Self {
            session,
            supervisor: SupervisorConfig {
                // Half a second in which nothing else can happen.
                settling_poses: 3,
                ..supervisor
            },
            configurations: [session.configuration, other],
            planted: None,
        })
    }
}

/// The state.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) now: Time,
    /// When the board's clock was zero.
    board_start: Time,
    seeds: u64,
    pub(crate) host: Host,
    pub(crate) board: Board,
    to_board: Line<ToBoard>,
    to_host: Line<ToHost>,
    cameras: bool,
    car: Car,
    claims: Claims,
    planted: Option<Planted>,
}

impl World {
    pub(crate) fn new(setting: &Setting) -> Result<Self, String> {
        let now = Time(10_000 * TICK_NS);
        Ok(Self {
            now,
            board_start: now,
            seeds: 0,
            host: host(setting, 0, now)?,
            board: Board::new(ResetCause::PowerOn, SOFTWARE, car_id(setting)),
            to_board: Line::new(),
            to_host: Line::new(),
            cameras: true,
            car: Car::new(),
            claims: Claims::new(),
            planted: setting.planted,
        })
    }

    pub(crate) const fn board_us(&self) -> u32 {
        ((self.now.0 - self.board_start.0) / 1_000) as u32
    }

    /// Pulses of the motor so far, as the board counts them.
    pub(crate) const fn pulses(&self) -> u16 {
        self.car.pulses.count
    }

    /// What a person would call a change: the next step of time ends there.
    pub(crate) fn outline(&self) -> Outline {
        let session = &self.host.session;
        Outline {
            mode: self.host.supervisor.mode(),
            link: core::mem::discriminant(&session.state()),
            board: self.board.mode(),
        }
    }

    /// The operator puts right what is cut, and takes the hand from the drive.
    pub(crate) const fn mend(&mut self) {
        self.to_board.is_cut = false;
        self.to_host.is_cut = false;
        self.cameras = true;
        self.host.hand = false;
    }

    /// An event, before the tick of its action.
    pub(crate) fn apply(&mut self, event: Event, setting: &Setting) -> Result<(), String> {
        let now = self.now;
        match event {
            Event::Request(request) => self.ask(request),
            Event::Hand => self.host.hand = !self.host.hand,
            Event::Cameras => self.cameras = !self.cameras,
            Event::CutToBoard => self.to_board.is_cut = !self.to_board.is_cut,
            Event::CutToHost => self.to_host.is_cut = !self.to_host.is_cut,
            Event::HangUp => {
                self.to_board.clear();
                self.to_host.clear();
                self.host.reopen(now);
            }
            Event::BoardRestart => {
                self.board = Board::new(ResetCause::External, SOFTWARE, car_id(setting));
                self.board_start = now;
                self.to_board.clear();
                self.to_host.clear();
                self.car.board_restarted();
                self.claims.board_restarted();
                self.claims.end(Ended::AtOnce);
            }
            Event::HostRestart => {
                self.seeds = (self.seeds + 1) % SEEDS;
                self.host = host(setting, self.seeds, now)?;
                self.claims.end(Ended::AtOnce);
            }
            Event::Reconfigure => {
                let [first, second] = setting.configurations;
                let is_first = *self.host.session.configuration() == first;
                let next = if is_first { second } else { first };
                self.host.reconfigure(now, next);
            }
        }
        Ok(())
    }

    fn ask(&mut self, request: PilotRequest) {
        let configuration = *self.host.session.configuration();
        match request {
            PilotRequest::Arm(arming @ (Arming::Unattended | Arming::Held)) => {
                self.host.hand |= arming == Arming::Held;
                // One that drives or jogs already is not asked anything.
                if !self.host.supervisor.mode().is_underway() {
                    self.claims.wished(Wish::Drive, configuration);
                }
            }
            PilotRequest::Arm(Arming::Jog) => {
                self.host.hand = true;
                if !self.host.supervisor.mode().is_underway() {
                    self.claims.wished(Wish::Jog, configuration);
                }
            }
            PilotRequest::EmergencyStop if self.planted == Some(Planted::StopIgnored) => {
                return self.claims.end(Ended::AtOnce);
            }
            PilotRequest::EmergencyStop | PilotRequest::Halt => self.claims.end(Ended::AtOnce),
            _ => self.claims.end(Ended::Ramp),
        }
        let passed = match request {
            PilotRequest::Disarm if self.planted == Some(Planted::DisarmArms) => {
                PilotRequest::Arm(Arming::Unattended)
            }
            request => request,
        };
        self.host.supervisor.handle(&PilotEvent::Request(passed));
    }

    /// A tick of all, with what happens to the frames in it, and whether the host misses it.
    pub(crate) fn tick(&mut self, action: Action) -> Result<(), Violation> {
        let [to_board, to_host] = action.passages();
        self.now = Time(self.now.0 + TICK_NS);
        let now = self.now;
        let mut sent = Vec::new();
        if !action.host_is_late() {
            let seen = Seen {
                pose: self.cameras,
                speed: self.car.speed(),
            };
            self.host
                .tick(now, seen, &mut |frame| sent.extend_from_slice(frame));
        }
        let mut arrived = self
            .to_board
            .pass(Line::<ToBoard>::messages(&sent), to_board);
        let board_us = self.board_us();
        let behind = arrived.iter().filter_map(|message| match message {
            ToBoard::Drive(drive) => Some(drive.telemetry_time_us),
            ToBoard::Jog(jog) => Some(jog.telemetry_time_us),
            _ => None,
        });
        let behind = behind.filter(|&time| time <= board_us).max();
        if let Some(planted) = self.planted {
            planted.tamper(&mut arrived, board_us);
        }
        let inputs = Inputs {
            motor: self.car.pulses,
            imu: Some(ImuSample {
                time_us: board_us,
                ..ImuSample::default()
            }),
            battery_mv: 7_400,
            supply_mv: 5_000,
            ..Inputs::default()
        };
        let mut said = Vec::new();
        let outputs = self
            .board
            .poll(board_us, &inputs, &bytes(&arrived), &mut |frame| {
                said.extend_from_slice(frame);
                true
            });
        let heard = self.to_host.pass(Line::<ToHost>::messages(&said), to_host);
        self.host.received(now, &bytes(&heard));
        self.car.advance(self.is_driven(&outputs), board_us);
        self.claims.check(&Facts {
            mode: self.board.mode(),
            outputs: &outputs,
            configuration: self.board.configuration(),
            board_us,
            behind,
            pose: self.cameras,
        })
    }

    /// Whether the motor drives: beyond the deadband.
    fn is_driven(&self, outputs: &Outputs) -> bool {
        let deadband = self
            .board
            .configuration()
            .map_or(0, |configuration| configuration.esc.deadband_us);
        outputs
            .esc_us
            .is_some_and(|pulse| pulse.abs_diff(outputs.esc_neutral_us) > deadband)
    }
}

/// What a person would call the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outline {
    pub(crate) mode: Mode,
    link: core::mem::Discriminant<singletrack_link::State>,
    pub(crate) board: BoardMode,
}

fn host(setting: &Setting, seed: u64, now: Time) -> Result<Host, String> {
    let session = SessionConfig {
        nonce_seed: seed,
        ..setting.session
    };
    Host::new(session, setting.supervisor, now).map_err(|error| error.to_string())
}

const fn car_id(setting: &Setting) -> u16 {
    setting.session.configuration.car_id
}

/// A message of one direction.
pub(crate) trait Wire: Copy + core::fmt::Debug {
    fn decode(packet: Packet<'_>) -> Option<Self>;
    fn encode(&self) -> Frame;
}

impl Wire for ToBoard {
    fn decode(packet: Packet<'_>) -> Option<Self> {
        Self::decode(packet).ok()
    }

    fn encode(&self) -> Frame {
        self.encode()
    }
}

impl Wire for ToHost {
    fn decode(packet: Packet<'_>) -> Option<Self> {
        Self::decode(packet).ok()
    }

    fn encode(&self) -> Frame {
        self.encode()
    }
}

/// Frames under way, as messages, which can be compared.
#[derive(Clone, Debug)]
pub(crate) struct Line<M> {
    /// Nothing passes, until it is mended.
    is_cut: bool,
    waiting: Vec<M>,
}

impl<M: Wire> Line<M> {
    pub(crate) const fn new() -> Self {
        Self {
            is_cut: false,
            waiting: Vec::new(),
        }
    }

    /// The messages in these bytes: whole frames, as they were written.
    fn messages(bytes: &[u8]) -> Vec<M> {
        let mut decoder = Decoder::new();
        let mut messages = Vec::new();
        for &byte in bytes {
            if let Some(Ok(packet)) = decoder.push(byte) {
                messages.extend(M::decode(packet));
            }
        }
        messages
    }

    /// What arrives of the frames that were sent in this tick.
    pub(crate) fn pass(&mut self, sent: Vec<M>, passage: Passage) -> Vec<M> {
        let mut arrived = core::mem::take(&mut self.waiting);
        match passage {
            _ if self.is_cut => arrived.clear(),
            Passage::Whole => arrived.extend(sent),
            Passage::Lost => {}
            Passage::Late => {
                arrived.extend(sent);
                self.waiting = core::mem::take(&mut arrived);
            }
            Passage::Twice => {
                arrived.extend(&sent);
                self.waiting = sent;
            }
        }
        arrived
    }

    /// Nothing is under way any more.
    pub(crate) fn clear(&mut self) {
        self.waiting.clear();
    }
}

/// The bytes of messages.
pub(crate) fn bytes<M: Wire>(messages: &[M]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for message in messages {
        bytes.extend_from_slice(message.encode().as_bytes());
    }
    bytes
}

/// Speed while the ESC drives, and distance of the motor's pulses: one in each tick.
const DRIVEN_M_S: f64 = 0.3;

/// Ticks of the roll-out in which a pulse comes: at about 1 m/s².
const ROLL_OUT: [u8; 6] = [1, 2, 4, 6, 9, 14];

/// Ticks after which the car stands.
const STANDS_AFTER: u8 = 24;

/// Wheels and motor sensor.
#[derive(Clone, Debug)]
pub(crate) struct Car {
    /// Ticks since the ESC drove; [`STANDS_AFTER`] for a car that stands.
    rolled: u8,
    pub(crate) pulses: MotorPulses,
}

impl Car {
    pub(crate) const fn new() -> Self {
        Self {
            rolled: STANDS_AFTER,
            pulses: MotorPulses {
                count: 0,
                last_edge_us: 0,
            },
        }
    }

    /// The board has started again, with a clock of its own.
    pub(crate) const fn board_restarted(&mut self) {
        self.pulses = MotorPulses {
            count: 0,
            last_edge_us: 0,
        };
    }

    fn advance(&mut self, drives: bool, board_us: u32) {
        self.rolled = if drives {
            0
        } else {
            (self.rolled + 1).min(STANDS_AFTER)
        };
        if drives || ROLL_OUT.contains(&self.rolled) {
            self.pulses.count = self.pulses.count.wrapping_add(1);
            self.pulses.last_edge_us = board_us;
        }
    }

    pub(crate) fn speed(&self) -> f64 {
        DRIVEN_M_S * f64::from(STANDS_AFTER - self.rolled) / f64::from(STANDS_AFTER)
    }
}
