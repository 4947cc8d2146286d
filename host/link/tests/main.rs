//! The session with the board in virtual time.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod clock;
mod deadlines;
mod end_to_end;
mod handshake;
mod requests;

use std::{collections::VecDeque, num::NonZeroU32};

use singletrack_board::{Board, ImuSample, Inputs, Outputs};
use singletrack_control::statistics::Random;
use singletrack_link::{Event, Session, SessionConfig, State};
use singletrack_protocol::{
    Acknowledgement, BoardMode, Configuration, Configure, Decoder, EscCalibration, EscKind,
    FailsafeAction, Hello, Identity, ImuAxes, ImuState, LONGEST_ROLL_OUT_MS, Refusal,
    RefusalReason, Request, ResetCause, Sequence, ServoCalibration, SpeedLoop, StopCause,
    Telemetry, ToBoard, ToHost, UNNAMED, VERSION,
};

pub(crate) const MS: u64 = 1_000_000;
pub(crate) const START_NS: u64 = 500_000 * MS;

pub(crate) fn configuration() -> Configuration {
    Configuration {
        servo: ServoCalibration {
            centre_us: 1_500,
            gain_us_per_rad: 800,
            min_us: 1_000,
            max_us: 2_000,
            slew_us_per_20ms: 200,
        },
        esc: EscCalibration {
            kind: EscKind::Car,
            neutral_us: 1_500,
            deadband_us: 30,
            min_us: 1_000,
            max_us: 2_000,
            slew_us_per_20ms: 100,
            brake_us: 1_300,
        },
        speed: SpeedLoop {
            pulse_distance_um: 5_000,
            feed_forward_us_per_m_s: 100,
            proportional_us_per_m_s: 50,
            integral_us_per_m: 100,
            integral_limit_us: 100,
            max_forward_mm_s: 2_000,
            max_reverse_mm_s: 0,
        },
        failsafe: FailsafeAction::Coast,
        max_pose_age_ms: 900,
        stop_input: false,
        kill_output: false,
        max_roll_out_ms: LONGEST_ROLL_OUT_MS,
        car_id: 0,
        imu_axes: ImuAxes::AS_PRINTED,
    }
}

pub(crate) fn session_config() -> SessionConfig {
    SessionConfig {
        configuration: configuration(),
        software_version: [0, 1, 0],
        nonce_seed: 42,
        baud: NonZeroU32::new(115_200).unwrap(),
    }
}

/// The messages in `bytes`, which must all be good.
pub(crate) fn to_board(bytes: &[u8]) -> Vec<ToBoard> {
    let mut decoder = Decoder::new();
    bytes
        .iter()
        .filter_map(|&byte| {
            decoder
                .push(byte)
                .map(|packet| ToBoard::decode(packet.unwrap()).unwrap())
        })
        .collect()
}

pub(crate) fn telemetry(board_time_us: u32, mode: BoardMode, last_sequence: Sequence) -> Telemetry {
    Telemetry {
        board_time_us,
        mode,
        stop_cause: StopCause::None,
        last_sequence,
        imu: ImuState::Fresh,
        imu_age_100us: 42,
        linear_acceleration_mm_s2: [0; 3],
        angular_velocity_mrad_s: [0; 3],
        attitude_q14: [16_384, 0, 0, 0],
        motor_speed_mm_s: 0,
        servo_us: 1_500,
        esc_us: 1_500,
    }
}

/// A session, its time, and everything it has sent and reported.
pub(crate) struct Bench {
    pub(crate) session: Session,
    pub(crate) now_ns: u64,
    pub(crate) events: Vec<Event>,
    /// What was sent since the list was cleared, with its time.
    pub(crate) sent: Vec<(u64, ToBoard)>,
    pub(crate) board_time_us: u32,
    pub(crate) board_mode: BoardMode,
    pub(crate) last_sequence: Sequence,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self {
            session: Session::new(session_config()).unwrap(),
            now_ns: START_NS,
            events: Vec::new(),
            sent: Vec::new(),
            board_time_us: 7_000_000,
            board_mode: BoardMode::Neutral,
            last_sequence: Sequence(200),
        }
    }

    pub(crate) fn opened() -> Self {
        let mut bench = Self::new();
        bench.session.handle_opened(bench.now_ns);
        bench.poll();
        bench
    }

    /// Connected and configured, with one telemetry record.
    pub(crate) fn ready() -> Self {
        let mut bench = Self::opened();
        bench.answer_hello();
        bench.answer_configure();
        bench.pass(10 * MS);
        bench.sent.clear();
        bench.events.clear();
        bench
    }

    /// Armed, as telemetry says.
    pub(crate) fn armed() -> Self {
        let mut bench = Self::ready();
        let sequence = bench.session.arm(bench.now_ns).unwrap();
        bench.poll();
        bench.acknowledge(Request::Arm, sequence);
        bench.board_mode = BoardMode::Armed;
        bench.pass(10 * MS);
        bench.sent.clear();
        bench.events.clear();
        bench
    }

    pub(crate) fn poll(&mut self) {
        while let Some(transmit) = self.session.poll_transmit(self.now_ns) {
            for message in to_board(transmit.as_bytes()) {
                self.sent.push((self.now_ns, message));
            }
        }
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        let events = &mut self.events;
        self.session
            .handle_bytes(self.now_ns, bytes, &mut |event| events.push(event));
        self.poll();
    }

    pub(crate) fn hear(&mut self, message: impl Into<ToHost>) {
        self.bytes(message.into().encode().as_bytes());
    }

    pub(crate) fn telemetry(&mut self) {
        self.hear(telemetry(
            self.board_time_us,
            self.board_mode,
            self.last_sequence,
        ));
    }

    pub(crate) fn timeout(&mut self) {
        let events = &mut self.events;
        self.session
            .handle_timeout(self.now_ns, &mut |event| events.push(event));
        self.poll();
    }

    /// Time passes on both clocks; the session is called at its deadlines.
    pub(crate) fn pass_in_silence(&mut self, span_ns: u64) {
        self.poll();
        let end_ns = self.now_ns + span_ns;
        while let Some(wake_ns) = self.session.poll_timeout()
            && wake_ns <= end_ns
        {
            assert!(wake_ns > self.now_ns, "the deadline is in the past");
            self.advance_to(wake_ns);
            self.timeout();
        }
        self.advance_to(end_ns);
        self.timeout();
    }

    fn advance_to(&mut self, time_ns: u64) {
        let passed_us = (time_ns - self.now_ns) / 1_000;
        self.board_time_us = self.board_time_us.wrapping_add(passed_us as u32);
        self.now_ns = time_ns;
    }

    /// Time passes with a record every 10 ms.
    pub(crate) fn pass(&mut self, span_ns: u64) {
        for _ in 0..span_ns / (10 * MS) {
            self.pass_in_silence(10 * MS);
            self.telemetry();
        }
    }

    /// The number in the newest greeting.
    pub(crate) fn nonce(&self) -> u32 {
        self.sent
            .iter()
            .rev()
            .find_map(|(_, message)| match message {
                ToBoard::Hello(hello) => Some(hello.nonce),
                _ => None,
            })
            .expect("a greeting has been sent")
    }

    pub(crate) fn answer_hello(&mut self) {
        self.answer_hello_as(VERSION);
    }

    pub(crate) fn answer_hello_as(&mut self, protocol_version: u16) {
        let nonce = self.nonce();
        self.hear(Hello {
            protocol_version,
            software_version: [9, 8, 7],
            nonce,
        });
        self.hear(Identity { car_id: 0 });
    }

    pub(crate) fn announce_restart(&mut self) {
        self.board_time_us = 1_000;
        self.board_mode = BoardMode::Boot;
        self.hear(Hello {
            protocol_version: VERSION,
            software_version: [9, 8, 7],
            nonce: 0,
        });
    }

    pub(crate) fn last_configure(&self) -> Configure {
        self.sent
            .iter()
            .rev()
            .find_map(|(_, message)| match message {
                ToBoard::Configure(configure) => Some(*configure),
                _ => None,
            })
            .expect("a configuration has been sent")
    }

    pub(crate) fn answer_configure(&mut self) {
        let sequence = self.last_configure().request;
        self.acknowledge(Request::Configure, sequence);
    }

    pub(crate) fn acknowledge(&mut self, request: Request, sequence: Sequence) {
        let configuration_hash = self.session.configuration_hash();
        self.hear(Acknowledgement {
            request,
            sequence,
            configuration_hash,
        });
    }

    pub(crate) fn refuse(&mut self, request: Request, sequence: Sequence, reason: RefusalReason) {
        self.hear(Refusal {
            request,
            sequence,
            reason,
        });
    }

    /// Times at which a kind of message was sent, in ms since `start_ns`.
    pub(crate) fn sent_ms(&self, start_ns: u64, is: impl Fn(&ToBoard) -> bool) -> Vec<u64> {
        self.sent
            .iter()
            .filter(|(_, message)| is(message))
            .map(|(time_ns, _)| (time_ns - start_ns) / MS)
            .collect()
    }

    pub(crate) fn is_ready(&self) -> bool {
        matches!(self.session.state(), State::Ready { .. })
    }

    pub(crate) fn has(&self, wanted: Event) -> bool {
        self.events.contains(&wanted)
    }
}

/// Time between two motor pulses at about 0.4 m/s.
const PULSE_US: u32 = 12_000;

pub(crate) struct TestBoard {
    board: Board,
    inputs: Inputs,
    outputs: Outputs,
    /// How often it went from not armed to armed.
    pub(crate) armed: u32,
    /// Commands obeyed, distinguished by the end of their time to live.
    pub(crate) driven: u32,
}

impl TestBoard {
    pub(crate) fn started() -> Self {
        let board = Board::new(ResetCause::External, [0, 1, 0], UNNAMED);
        Self {
            outputs: board.outputs(),
            board,
            inputs: Inputs {
                battery_mv: 7_400,
                ..Inputs::default()
            },
            armed: 0,
            driven: 0,
        }
    }

    pub(crate) fn mode(&self) -> BoardMode {
        self.board.mode()
    }

    pub(crate) fn configuration(&self) -> Option<&Configuration> {
        self.board.configuration()
    }

    /// What the board says at `now_us` to the bytes that have arrived.
    pub(crate) fn poll(&mut self, now_us: u32, bytes: &[u8]) -> Vec<u8> {
        let turning = self.mode() == BoardMode::Driving;
        if turning && now_us.wrapping_sub(self.inputs.motor.last_edge_us) >= PULSE_US {
            self.inputs.motor.count = self.inputs.motor.count.wrapping_add(1);
            self.inputs.motor.last_edge_us = now_us;
        }
        self.inputs.imu = Some(ImuSample {
            time_us: now_us,
            ..ImuSample::default()
        });
        let was_armed = self.is_armed();
        let mut said = Vec::new();
        let outputs = self.board.poll(now_us, &self.inputs, bytes, &mut |frame| {
            said.extend_from_slice(frame);
            true
        });
        let deadline_us = outputs.drive_deadline_us;
        self.armed += u32::from(!was_armed && self.is_armed());
        self.driven +=
            u32::from(deadline_us.is_some() && deadline_us != self.outputs.drive_deadline_us);
        self.outputs = outputs;
        said
    }

    fn is_armed(&self) -> bool {
        matches!(self.mode(), BoardMode::Armed | BoardMode::Driving)
    }
}

/// Ten bits at 115200 baud.
const BYTE_NS: u64 = 86_806;

/// What goes wrong, for every byte.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    pub(crate) corrupt: f64,
    pub(crate) drop: f64,
}

/// One direction.
pub(crate) struct Wire {
    noise: Random,
    pub(crate) faults: Faults,
    /// Bytes with the time at which they arrive.
    under_way: VecDeque<(u64, u8)>,
    free_at_ns: u64,
    /// While true, nothing comes out, and everything waits.
    pub(crate) stuck: bool,
}

impl Wire {
    pub(crate) fn new(seed: u64, faults: Faults) -> Self {
        Self {
            noise: Random::new(seed),
            faults,
            under_way: VecDeque::new(),
            free_at_ns: 0,
            stuck: false,
        }
    }

    pub(crate) fn put(&mut self, now_ns: u64, bytes: &[u8]) {
        self.free_at_ns = self.free_at_ns.max(now_ns);
        for &byte in bytes {
            self.free_at_ns += BYTE_NS;
            if self.noise.happens(self.faults.drop) {
                continue;
            }
            let damage = if self.noise.happens(self.faults.corrupt) {
                (self.noise.bits() % 255 + 1) as u8
            } else {
                0
            };
            self.under_way.push_back((self.free_at_ns, byte ^ damage));
        }
    }

    pub(crate) fn take(&mut self, now_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while !self.stuck
            && let Some(&(arrival_ns, byte)) = self.under_way.front()
            && arrival_ns <= now_ns
        {
            bytes.push(byte);
            self.under_way.pop_front();
        }
        bytes
    }

    pub(crate) fn clear(&mut self) {
        self.under_way.clear();
        self.free_at_ns = 0;
    }
}
