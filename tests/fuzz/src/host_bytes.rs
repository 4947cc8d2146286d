//! Fuzz target: bytes on the serial line to the host.

use core::num::NonZeroU32;

use singletrack_link::{
    DriveCommand, Event, JogCommand, Session, SessionConfig, State, TimedTelemetry,
};
use singletrack_protocol::{
    BoardMode, Configuration, Decoder, Drive, Hello, Identity, ImuState, RefusalReason, Request,
    ResetCause, Sequence, Status, StopCause, Telemetry, ToBoard, ToHost, UNSOLICITED, VERSION,
};

use crate::choices::{CONFIGURATION, Choices, frame};

const MS: u64 = 1_000_000;

/// Largest number of messages that the session sends at one time: a stop, a
/// greeting or a configuration, an arm request.
const TRANSMITS: usize = 3;

/// Type bytes of the messages to the host, and an invalid one.
const KINDS: [u8; 6] = [0x01, 0x20, 0x21, 0x22, 0x23, 0x13];

// The session owns no heap memory.
const _: () = assert!(size_of::<Session>() <= 8_192);

/// Runs the session on bytes from the serial line, while its owner arms, drives,
/// stops, closes and opens the port, with any time steps.
///
/// The first byte selects the initial state.
///
/// # Panics
///
/// If the session connects without an answer to its own greeting; if it sends bytes
/// that are not a message, more than one of a kind at a time, or an arm request
/// that was not made or that survived a loss, a restart or a stop; if it makes a
/// command for a board that is not armed, or with other values than it was given;
/// if times of a record run backwards or lie in the future; if it requests a
/// wake-up in the past.
///
/// Returns the number of bytes passed to the session.
pub fn host_bytes(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    let mut bench = Bench::at_stage(choices.byte());
    while !choices.is_empty() {
        bench.step(&mut choices);
    }
    bench.bytes
}

struct Bench {
    session: Session,
    now_ns: u64,
    /// Model of the board.
    board_time_us: u32,
    board_mode: BoardMode,
    /// Decodes the bytes to the session.
    mirror: Decoder,
    /// Nonce of the newest greeting.
    nonce: u32,
    /// The newest greeting that was answered.
    answered: Option<u32>,
    /// Request number of the newest configuration sent.
    configure: Sequence,
    /// The arm request that may still be sent.
    arm: Option<Sequence>,
    stop: Sequence,
    newest: Option<TimedTelemetry>,
    /// Number of bytes passed to the session.
    bytes: u64,
}

/// The messages in one call, by the mirror decoder.
#[derive(Default)]
struct CallMessages {
    frames: usize,
    answer_to_greeting: bool,
}

impl Bench {
    fn at_stage(options: u8) -> Self {
        let config = SessionConfig {
            configuration: CONFIGURATION,
            software_version: [0, 1, 0],
            nonce_seed: u64::from(options),
            baud: NonZeroU32::new(115_200).unwrap_or(NonZeroU32::MIN),
        };
        let mut bench = Self {
            session: Session::new(config).expect("the configuration is valid"),
            now_ns: 500_000 * MS,
            board_time_us: if options & 0x80 != 0 {
                u32::MAX - 500_000
            } else {
                7_000_000
            },
            board_mode: BoardMode::Neutral,
            mirror: Decoder::new(),
            nonce: 0,
            answered: None,
            configure: Sequence(0),
            arm: None,
            stop: Sequence(0),
            newest: None,
            bytes: 0,
        };
        let stage = options & 7;
        if stage >= 1 {
            bench.open();
        }
        if stage >= 2 {
            bench.greet(VERSION);
        }
        if stage >= 3 {
            bench.acknowledge(Request::Configure, bench.configure);
            bench.run(3);
        }
        if stage >= 4 {
            bench.request_arm();
        }
        if stage >= 5 {
            let sequence = bench.arm.unwrap_or_default();
            bench.acknowledge(Request::Arm, sequence);
            bench.board_mode = BoardMode::Armed;
            bench.run(2);
        }
        bench
    }

    fn step(&mut self, choices: &mut Choices<'_>) {
        match choices.byte() % 26 {
            0 => self.receive(choices.bytes()),
            1 => {
                let kind = choices.byte();
                self.receive(&frame(kind, choices.bytes()));
            }
            2 => {
                let mut bytes = Vec::new();
                for _ in 0..choices.byte() % 8 {
                    bytes.extend_from_slice(&frame(choices.one_of(KINDS), choices.bytes()));
                }
                bytes.truncate(usize::from(choices.u16()));
                self.receive(&bytes);
            }
            3 => self.greet(VERSION),
            4 => self.greet(choices.u16()),
            5 => self.send(Hello {
                protocol_version: VERSION,
                software_version: [0; 3],
                nonce: if choices.flag() {
                    UNSOLICITED
                } else {
                    choices.u32()
                },
            }),
            6 => self.acknowledge(Request::Configure, self.configure),
            // Any type, request, number and hash.
            7 => {
                let sequence = self.some_sequence(choices);
                let [a, b, c, d] = choices.u32().to_le_bytes();
                let request = choices.byte() % 5;
                self.receive(&frame(0x22, &[request, sequence.0, a, b, c, d]));
            }
            8 => {
                let sequence = self.some_sequence(choices);
                let (request, reason) = (choices.byte() % 5, choices.byte() % 16);
                self.receive(&frame(0x23, &[request, sequence.0, reason]));
            }
            9 => self.run(choices.byte() % 16),
            10 => {
                self.board_mode = choices.one_of([
                    BoardMode::Boot,
                    BoardMode::Neutral,
                    BoardMode::Armed,
                    BoardMode::Driving,
                    BoardMode::Jogging,
                    BoardMode::Failsafe,
                    BoardMode::EmergencyStopped,
                ]);
                self.run(1);
            }
            11 => {
                self.board_time_us = choices.u32();
                let telemetry = self.any_telemetry(choices);
                self.send(telemetry);
            }
            12 => {
                let telemetry = self.any_telemetry(choices);
                self.send(telemetry);
            }
            13 => {
                let status = self.any_status(choices);
                self.send(status);
            }
            14 => self.pass(u64::from(choices.u16()) * 1_000),
            15 => self.pass(u64::from(choices.byte()) * 10 * MS),
            16 => self.pass(choices.u32().into()),
            17 => self.request_arm(),
            18 => {
                self.stop = self.session.disarm(self.now_ns);
                self.arm = None;
                self.settle();
            }
            19 => {
                self.stop = self.session.emergency_stop(self.now_ns);
                self.arm = None;
                self.settle();
            }
            20 => {
                let configuration = Configuration {
                    max_pose_age_ms: choices.u16(),
                    ..CONFIGURATION
                };
                // Refused while armed, without effect.
                let hash = self.session.configuration_hash();
                if self.session.configure(self.now_ns, configuration).is_err() {
                    assert_eq!(self.session.configuration_hash(), hash);
                }
                self.settle();
            }
            21 => self.drive(DriveCommand {
                speed_m_s: choices.f64(),
                steering_rad: choices.f64(),
                brake: choices.flag(),
                pose_time_ns: choices.flag().then(|| choices.u64()),
            }),
            22 => {
                for _ in 0..choices.byte() % 16 {
                    self.drive(DriveCommand {
                        speed_m_s: 0.5,
                        steering_rad: -0.2,
                        brake: false,
                        pose_time_ns: Some(self.now_ns - 8 * MS),
                    });
                    self.run(1);
                }
            }
            24 => self.jog(JogCommand {
                servo_us: choices.u16(),
                esc_us: choices.u16(),
            }),
            25 => {
                for _ in 0..choices.byte() % 16 {
                    self.jog(JogCommand {
                        servo_us: 1_400,
                        esc_us: 1_560,
                    });
                    self.run(1);
                }
            }
            _ => {
                if choices.flag() {
                    self.close();
                }
                self.open();
            }
        }
    }

    fn some_sequence(&self, choices: &mut Choices<'_>) -> Sequence {
        let any = Sequence(choices.byte());
        choices.one_of([any, self.configure, self.arm.unwrap_or(any), self.stop])
    }

    fn open(&mut self) {
        self.session.handle_opened(self.now_ns);
        self.mirror = Decoder::new();
        self.arm = None;
        self.settle();
    }

    fn close(&mut self) {
        let mut events = Vec::new();
        self.session
            .handle_closed(self.now_ns, &mut |event| events.push(event));
        self.arm = None;
        assert_eq!(self.session.state(), State::Disconnected);
        assert!(events.len() <= 1);
    }

    fn greet(&mut self, protocol_version: u16) {
        self.send(Hello {
            protocol_version,
            software_version: [9, 8, 7],
            nonce: self.nonce,
        });
        self.send(Identity { car_id: 0 });
    }

    fn acknowledge(&mut self, request: Request, sequence: Sequence) {
        self.send(singletrack_protocol::Acknowledgement {
            request,
            sequence,
            configuration_hash: self.session.configuration_hash(),
        });
    }

    fn request_arm(&mut self) {
        let ready = matches!(self.session.state(), State::Ready { .. });
        if let Ok(sequence) = self.session.arm(self.now_ns) {
            assert!(ready, "armed without a ready board");
            assert!(!self.session.is_stop_pending(), "armed across a stop");
            self.arm = Some(sequence);
        }
        self.settle();
    }

    fn drive(&mut self, command: DriveCommand) {
        let mode = match self.session.state() {
            State::Ready { mode } => mode,
            _ => None,
        };
        let Ok(bytes) = self.session.drive(self.now_ns, command) else {
            return;
        };
        assert!(
            matches!(mode, Some(BoardMode::Armed | BoardMode::Driving)),
            "a command for a board in {mode:?}"
        );
        assert!(!self.session.is_stop_pending(), "a command across a stop");
        let ToBoard::Drive(drive) = message_to_board(bytes.as_bytes()) else {
            panic!("not a drive command");
        };
        self.check_drive(&command, &drive);
    }

    fn jog(&mut self, command: JogCommand) {
        let mode = match self.session.state() {
            State::Ready { mode } => mode,
            _ => None,
        };
        let Ok(bytes) = self.session.jog(self.now_ns, command) else {
            return;
        };
        assert!(
            matches!(mode, Some(BoardMode::Armed | BoardMode::Jogging)),
            "pulses for a board in {mode:?}"
        );
        assert!(!self.session.is_stop_pending(), "pulses across a stop");
        let ToBoard::Jog(jog) = message_to_board(bytes.as_bytes()) else {
            panic!("not pulses");
        };
        assert_eq!(
            (jog.servo_us, jog.esc_us),
            (command.servo_us, command.esc_us)
        );
    }

    fn check_drive(&self, command: &DriveCommand, drive: &Drive) {
        let near = |steps: i16, value: f64| (f64::from(steps) - value).abs() <= 0.5 + 1e-9;
        assert!(near(drive.speed_mm_s, command.speed_m_s * 1_000.0));
        assert!(near(
            drive.steering_100urad,
            command.steering_rad * 10_000.0
        ));
        let newest = self.newest.expect("a command rests on telemetry");
        assert_eq!(drive.telemetry_time_us, newest.telemetry.board_time_us);
        assert!(drive.sequence.is_newer_than(newest.telemetry.last_sequence));
        // The reported age is never too small.
        let age_ns = command.pose_time_ns.map_or(u64::MAX, |pose_ns| {
            newest.board_time_host_ns.saturating_sub(pose_ns)
        });
        assert!(
            drive.pose_age_ms == u16::MAX || u64::from(drive.pose_age_ms) * MS >= age_ns,
            "{age_ns} ns reported as {} ms",
            drive.pose_age_ms
        );
    }

    /// Telemetry every 10 ms.
    fn run(&mut self, records: u8) {
        for _ in 0..records {
            self.pass(10 * MS);
            self.send(self.telemetry());
        }
    }

    fn telemetry(&self) -> Telemetry {
        Telemetry {
            board_time_us: self.board_time_us,
            mode: self.board_mode,
            stop_cause: StopCause::None,
            last_sequence: Sequence(200),
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

    fn any_telemetry(&self, choices: &mut Choices<'_>) -> Telemetry {
        Telemetry {
            last_sequence: Sequence(choices.byte()),
            imu: choices.one_of([ImuState::Fresh, ImuState::Repeated, ImuState::Silent]),
            imu_age_100us: choices.byte(),
            linear_acceleration_mm_s2: [choices.i16(); 3],
            angular_velocity_mrad_s: [choices.i16(); 3],
            attitude_q14: [choices.i16(); 4],
            motor_speed_mm_s: choices.i16(),
            ..self.telemetry()
        }
    }

    fn any_status(&self, choices: &mut Choices<'_>) -> Status {
        Status {
            board_time_us: self.board_time_us,
            configuration_hash: if choices.flag() {
                choices.u32()
            } else {
                self.session.configuration_hash()
            },
            reset_cause: ResetCause::PowerOn,
            stop_input_open: choices.flag(),
            battery_mv: choices.u16(),
            frames_received: choices.u16(),
            frames_damaged: choices.u16(),
            drives_refused: choices.u16(),
            last_refusal: RefusalReason::None,
            frames_dropped: choices.u16(),
            bytes_overrun: choices.u16(),
            imu_errors: choices.u16(),
            supply_mv: choices.u16(),
            battery_open: choices.flag(),
            power_on: choices.flag(),
            edges_refused: choices.u16(),
            imu_calibration: choices.byte(),
            imu_status: choices.byte(),
            imu_error: choices.byte(),
            imu_self_test: choices.byte(),
        }
    }

    fn pass(&mut self, span_ns: u64) {
        self.now_ns += span_ns;
        self.board_time_us = self.board_time_us.wrapping_add((span_ns / 1_000) as u32);
        self.settle();
    }

    fn send(&mut self, message: impl Into<ToHost>) {
        // Ends a partial frame on the line.
        let mut bytes = vec![0];
        bytes.extend_from_slice(message.into().encode().as_bytes());
        self.receive(&bytes);
    }

    fn receive(&mut self, bytes: &[u8]) {
        self.bytes += bytes.len() as u64;
        let mut messages = CallMessages::default();
        for &byte in bytes {
            let Some(Ok(packet)) = self.mirror.push(byte) else {
                continue;
            };
            messages.frames += 1;
            match ToHost::decode(packet) {
                Ok(ToHost::Hello(hello))
                    if hello.nonce == self.nonce && hello.protocol_version == VERSION =>
                {
                    self.answered = Some(hello.nonce);
                }
                // An echo of the greeting is followed by no such message.
                Ok(ToHost::Identity(_)) => {
                    messages.answer_to_greeting |= self.answered == Some(self.nonce);
                }
                _ => {}
            }
        }
        let mut events = Vec::new();
        self.session
            .handle_bytes(self.now_ns, bytes, &mut |event| events.push(event));
        assert!(
            events.len() <= 3 * messages.frames,
            "{} events of {} frames",
            events.len(),
            messages.frames
        );
        for event in events {
            self.check_event(&event, messages.answer_to_greeting);
        }
        self.settle();
    }

    fn check_event(&mut self, event: &Event, answer_to_greeting: bool) {
        match event {
            Event::Identified { .. } => {}
            Event::Connected { .. } => {
                assert!(
                    answer_to_greeting,
                    "connected by a greeting that is not an answer"
                );
            }
            Event::Lost { .. } | Event::BoardRestarted { .. } => self.arm = None,
            Event::Acknowledged { request, sequence }
            | Event::Refused {
                request, sequence, ..
            }
            | Event::Unanswered { request, sequence } => match request {
                Request::Arm => {
                    assert_eq!(
                        self.arm.take(),
                        Some(*sequence),
                        "an answer without a request"
                    );
                }
                Request::Disarm | Request::EmergencyStop => assert_eq!(*sequence, self.stop),
                Request::Configure => {}
            },
            Event::Telemetry(record) => self.check_times(record),
            _ => {}
        }
    }

    fn check_times(&mut self, record: &TimedTelemetry) {
        assert_eq!(record.receive_time_ns, self.now_ns);
        assert!(record.board_time_host_ns <= record.receive_time_ns);
        if let Some(imu_ns) = record.imu_time_host_ns {
            assert!(imu_ns <= record.receive_time_ns);
        }
        if let Some(before) = self.newest.replace(*record) {
            assert!(
                record.board_time_host_ns >= before.board_time_host_ns,
                "a record made before the last one"
            );
            if let (Some(now), Some(before)) = (record.imu_time_host_ns, before.imu_time_host_ns) {
                assert!(now >= before, "a sample taken before the last one");
            }
        }
    }

    /// Lets the session handle timeouts and send what is due.
    fn settle(&mut self) {
        let mut events = Vec::new();
        self.session
            .handle_timeout(self.now_ns, &mut |event| events.push(event));
        assert!(events.len() <= 2);
        for event in events {
            self.check_event(&event, false);
        }
        let mut sent = 0;
        while let Some(transmit) = self.session.poll_transmit(self.now_ns) {
            sent += 1;
            assert!(sent <= TRANSMITS, "unbounded sending");
            self.check_transmit(message_to_board(transmit.as_bytes()));
        }
        if let Some(wake_ns) = self.session.poll_timeout() {
            assert!(wake_ns > self.now_ns, "a wake-up in the past");
        }
    }

    fn check_transmit(&mut self, message: ToBoard) {
        let state = self.session.state();
        match message {
            ToBoard::Hello(hello) => self.nonce = hello.nonce,
            ToBoard::Configure(configure) => {
                assert!(
                    matches!(
                        state,
                        State::Configuring | State::ConfigurationRefused { .. }
                    ),
                    "configures in {state:?}"
                );
                assert_eq!(
                    configure.configuration.hash(),
                    self.session.configuration_hash()
                );
                self.configure = configure.request;
            }
            ToBoard::Arm(arm) => {
                assert_eq!(
                    Some(arm.request),
                    self.arm,
                    "an arm request without a request in {state:?}"
                );
                assert!(!self.session.is_stop_pending(), "arms across a stop");
            }
            ToBoard::Disarm(_) | ToBoard::EmergencyStop(_) => {
                assert!(self.session.is_stop_pending());
            }
            ToBoard::Drive(_) | ToBoard::Jog(_) => panic!("a command without a request"),
        }
    }
}

/// Decodes bytes that must be one message.
fn message_to_board(bytes: &[u8]) -> ToBoard {
    let mut decoder = Decoder::new();
    let messages: Vec<_> = bytes
        .iter()
        .filter_map(|&byte| decoder.push(byte).map(|packet| packet.map(ToBoard::decode)))
        .collect();
    match messages.as_slice() {
        [Ok(Ok(message))] => *message,
        _ => panic!("{bytes:?} is not one message"),
    }
}

#[cfg(test)]
mod tests {
    use super::{Bench, BoardMode, State};

    #[test]
    fn the_first_byte_selects_the_initial_state() {
        for options in [0, 0x40, 0x80, 0xF8] {
            let state = |stage| Bench::at_stage(options | stage).session.state();
            assert_eq!(state(0), State::Disconnected);
            assert!(matches!(state(1), State::Greeting { .. }));
            assert_eq!(state(2), State::Configuring);
            let ready = |mode| State::Ready { mode: Some(mode) };
            assert_eq!(state(3), ready(BoardMode::Neutral));
            assert!(Bench::at_stage(options | 4).arm.is_some());
            assert_eq!(state(5), ready(BoardMode::Armed));
        }
    }
}
