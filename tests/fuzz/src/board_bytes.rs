//! Fuzz target: bytes on the serial line to the board.

use singletrack_board::{Board, ImuSample, Inputs, Outputs};
use singletrack_protocol::{
    Arm, BoardMode, COMMAND_TIME_TO_LIVE_US, Configuration, Configure, Decoder, Disarm, Drive,
    EmergencyStop, EscKind, FailsafeAction, Hello, ImuAxis, JOG_DRIVE_US, JOG_LIMIT_US, Jog,
    ResetCause, Sequence, ToBoard, ToHost, UNNAMED, VERSION,
};

use crate::choices::{CONFIGURATION, Choices, frame};

const MS: u32 = 1_000;

/// ESC pulse without a configuration, in µs.
const NEUTRAL_AT_START_US: u16 = 1_500;

/// Type bytes of the messages to the board, and an invalid one.
const KINDS: [u8; 8] = [0x01, 0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x20];

/// Largest number of frames in a poll besides answers: twice a zero and two
/// greetings, a telemetry record and a status record.
const MAX_UNSOLICITED: usize = 8;

// The board owns no heap memory.
const _: () = assert!(!core::mem::needs_drop::<Board>());
const _: () = assert!(size_of::<Board>() <= 512);

/// Runs the board on bytes from the serial line, with any pins and any time steps.
///
/// The first byte selects the initial state of host and board; the others select
/// events: bytes, frames around any payload, messages that fit the state, time,
/// pins.
///
/// # Panics
///
/// If the board drives or jogs without an `Arm` of its configuration and a `Drive` or
/// a `Jog` after it, or longer than a command's time to live; if a pulse violates the
/// configuration's limits or slew rate; if a mode transition is invalid; if it
/// sends bytes that are not a frame, or more frames than requested; if the last
/// received stop does not stop it.
///
/// Returns the number of bytes passed to the board.
pub fn board_bytes(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    let mut bench = Bench::at_stage(&mut choices);
    while !choices.is_empty() {
        bench.step(&mut choices);
    }
    bench.bytes
}

struct Bench {
    board: Board,
    now_us: u32,
    inputs: Inputs,
    outputs: Outputs,
    /// Time between two motor pulses while the ESC drives.
    pulse_period_us: Option<u32>,
    line_open: bool,
    /// Decodes the bytes to the board.
    mirror: Decoder,
    polled_us: u32,
    request: u8,
    braked_us: u32,
    /// Time for which the motor has been jogged without a pause.
    jogged_us: u32,
    /// Number of bytes passed to the board.
    bytes: u64,
}

/// The messages in one poll, by the mirror decoder.
#[derive(Default)]
struct PollMessages {
    frames: usize,
    configure: bool,
    /// Hashes of the board's present and past configurations.
    arm: bool,
    drive: bool,
    jog: bool,
    last: Option<ToBoard>,
}

impl Bench {
    fn at_stage(choices: &mut Choices<'_>) -> Self {
        let options = choices.byte();
        let is = |bit: u8| options & (1 << bit) != 0;
        let board = Board::new(ResetCause::PowerOn, [0, 1, 0], UNNAMED);
        let mut bench = Self {
            outputs: board.outputs(),
            board,
            now_us: if is(2) { u32::MAX - 2_500 * MS } else { 0 },
            inputs: Inputs {
                battery_mv: 7_400,
                ..Inputs::default()
            },
            pulse_period_us: Some(3 * MS),
            line_open: true,
            mirror: Decoder::new(),
            polled_us: 0,
            request: 0,
            braked_us: 0,
            jogged_us: 0,
            bytes: 0,
        };
        let configuration = Configuration {
            failsafe: if is(3) {
                FailsafeAction::Brake
            } else {
                FailsafeAction::Coast
            },
            stop_input: is(4),
            speed: singletrack_protocol::SpeedLoop {
                max_reverse_mm_s: if is(5) { 600 } else { 0 },
                ..CONFIGURATION.speed
            },
            ..CONFIGURATION
        };
        let stage = options & 3;
        bench.poll(&[]);
        if stage >= 1 {
            bench.send(Hello {
                protocol_version: VERSION,
                software_version: [0, 1, 0],
                nonce: 1,
            });
            bench.configure(configuration);
            bench.wait(11, 200 * MS);
        }
        if stage >= 2 {
            let arm = bench.arm_request();
            bench.send(arm);
        }
        if stage >= 3 {
            for _ in 0..3 {
                bench.drive_well(500, 1_000);
            }
        }
        bench
    }

    fn step(&mut self, choices: &mut Choices<'_>) {
        match choices.byte() % 23 {
            0 => self.poll(choices.bytes()),
            1 => {
                let kind = choices.byte();
                self.poll(&frame(kind, choices.bytes()));
            }
            // Several frames, or parts of them, in one poll.
            2 => {
                let mut bytes = Vec::new();
                for _ in 0..choices.byte() % 8 {
                    bytes.extend_from_slice(&frame(choices.one_of(KINDS), choices.bytes()));
                }
                bytes.truncate(usize::from(choices.u16()));
                self.poll(&bytes);
            }
            3 => self.wait(choices.byte() % 32 + 1, MS),
            4 => {
                let step_us = choices.u16();
                self.wait(choices.byte() % 8 + 1, step_us.into());
            }
            // Polls are closer together than half a turn of the clock.
            5 => self.wait(1, choices.u32() >> 1),
            6 => {
                let protocol_version = if choices.flag() {
                    VERSION
                } else {
                    choices.u16()
                };
                self.send(Hello {
                    protocol_version,
                    software_version: [1, 2, 3],
                    nonce: choices.byte().into(),
                });
            }
            7 => {
                let configuration = any_configuration(choices);
                self.configure(configuration);
            }
            8 => {
                let arm = self.arm_request();
                self.send(arm);
            }
            9 => {
                let arm = self.arm_request();
                self.send(Arm {
                    request: Sequence(choices.byte()),
                    configuration_hash: arm.configuration_hash ^ u32::from(choices.byte() & 2),
                    telemetry_time_us: self.now_us.wrapping_sub(choices.u32()),
                });
            }
            10 => {
                let request = self.next_request();
                self.send(Disarm { request });
            }
            11 => {
                let request = self.next_request();
                self.send(EmergencyStop { request });
            }
            12 => {
                let (speed, steering) = (choices.i16(), choices.i16());
                self.drive_well(speed, steering);
            }
            13 => self.send(Drive {
                sequence: Sequence(self.board.last_sequence().0.wrapping_add(choices.byte())),
                speed_mm_s: choices.i16(),
                steering_100urad: choices.i16(),
                telemetry_time_us: self.now_us.wrapping_sub(choices.u32()),
                pose_age_ms: choices.u16(),
                brake: choices.flag(),
            }),
            14 => {
                let period_us = u32::from(choices.u16());
                self.pulse_period_us = (period_us >= 50).then_some(period_us);
            }
            15 => {
                self.inputs.motor.count = choices.u16();
                self.inputs.motor.last_edge_us = choices.u32();
            }
            16 => self.inputs.stop_input_open = choices.flag(),
            17 => {
                self.inputs.imu = Some(ImuSample {
                    time_us: self.now_us.wrapping_sub(choices.u32()),
                    linear_acceleration_mm_s2: [choices.i16(); 3],
                    angular_velocity_mrad_s: [choices.i16(); 3],
                    attitude_q14: [choices.i16(); 4],
                });
            }
            18 => self.line_open = choices.flag(),
            20 => self.send(Jog {
                sequence: Sequence(self.board.last_sequence().0.wrapping_add(choices.byte())),
                telemetry_time_us: self.now_us.wrapping_sub(choices.u32()),
                servo_us: choices.u16(),
                esc_us: choices.u16(),
            }),
            21 => {
                // A correct host for a while.
                let (servo_us, esc_us) = (choices.u16(), choices.u16());
                for _ in 0..choices.byte() % 16 {
                    self.jog_well(servo_us, esc_us);
                }
            }
            22 => {
                // A disarm, an arm request and pulses: bytes alone seldom find this.
                let request = self.next_request();
                self.send(Disarm { request });
                self.wait(21, 100 * MS);
                let arm = self.arm_request();
                self.send(arm);
                self.jog_well(choices.u16(), choices.u16());
            }
            _ => {
                // A correct host for a while.
                let (speed, steering) = (choices.i16(), choices.i16());
                for _ in 0..choices.byte() % 16 {
                    self.drive_well(speed, steering);
                }
            }
        }
    }

    fn next_request(&mut self) -> Sequence {
        self.request = self.request.wrapping_add(1);
        Sequence(self.request)
    }

    fn arm_request(&mut self) -> Arm {
        Arm {
            request: self.next_request(),
            configuration_hash: self.board.configuration().map_or(0, Configuration::hash),
            telemetry_time_us: self.now_us,
        }
    }

    fn configure(&mut self, configuration: Configuration) {
        let request = self.next_request();
        self.send(Configure {
            request,
            configuration,
        });
    }

    fn drive_well(&mut self, speed_mm_s: i16, steering_100urad: i16) {
        self.send(Drive {
            sequence: self.board.last_sequence().next(),
            speed_mm_s,
            steering_100urad,
            telemetry_time_us: self.now_us,
            pose_age_ms: 10,
            brake: false,
        });
        self.wait(2, 5 * MS);
    }

    fn jog_well(&mut self, servo_us: u16, esc_us: u16) {
        self.send(Jog {
            sequence: self.board.last_sequence().next(),
            telemetry_time_us: self.now_us,
            servo_us,
            esc_us,
        });
        self.wait(2, 5 * MS);
    }

    fn send(&mut self, message: impl Into<ToBoard>) {
        // Ends a partial frame on the line.
        let mut bytes = vec![0];
        bytes.extend_from_slice(message.into().encode().as_bytes());
        self.poll(&bytes);
    }

    fn wait(&mut self, polls: u8, step_us: u32) {
        for _ in 0..polls {
            self.now_us = self.now_us.wrapping_add(step_us);
            self.poll(&[]);
        }
    }

    fn decode(&mut self, bytes: &[u8]) -> PollMessages {
        let mut messages = PollMessages::default();
        let mut hashes: Vec<_> = self
            .board
            .configuration()
            .map(Configuration::hash)
            .into_iter()
            .collect();
        for &byte in bytes {
            let Some(Ok(packet)) = self.mirror.push(byte) else {
                continue;
            };
            let Ok(message) = ToBoard::decode(packet) else {
                continue;
            };
            messages.frames += 1;
            match message {
                ToBoard::Configure(configure) => {
                    messages.configure = true;
                    hashes.push(configure.configuration.hash());
                }
                ToBoard::Arm(arm) => messages.arm |= hashes.contains(&arm.configuration_hash),
                ToBoard::Drive(_) => messages.drive = true,
                ToBoard::Jog(_) => messages.jog = true,
                _ => {}
            }
            messages.last = Some(message);
        }
        messages
    }

    fn turn_the_motor(&mut self) {
        let neutral = self.outputs.esc_neutral_us;
        let driven = self
            .outputs
            .esc_us
            .is_some_and(|pulse_us| pulse_us.abs_diff(neutral) > CONFIGURATION.esc.deadband_us);
        if let Some(period_us) = self.pulse_period_us
            && driven
        {
            let since_us = self.now_us.wrapping_sub(self.inputs.motor.last_edge_us);
            let pulses = since_us / period_us;
            if pulses > 0 {
                self.inputs.motor.count = self.inputs.motor.count.wrapping_add(pulses as u16);
                self.inputs.motor.last_edge_us = self.now_us;
            }
        }
    }

    fn poll(&mut self, received: &[u8]) {
        self.turn_the_motor();
        let before = Before {
            mode: self.board.mode(),
            configuration: self.board.configuration().copied(),
            servo_us: self.outputs.servo_us,
        };
        let messages = self.decode(received);
        self.bytes += received.len() as u64;
        let elapsed_us = self.now_us.wrapping_sub(self.polled_us);
        self.polled_us = self.now_us;
        let line_open = self.line_open;
        let mut sent = 0;
        self.outputs = self
            .board
            .poll(self.now_us, &self.inputs, received, &mut |bytes| {
                sent += 1;
                assert_is_frame(bytes);
                line_open
            });
        assert!(
            sent <= messages.frames + MAX_UNSOLICITED,
            "{sent} frames in answer to {}",
            messages.frames
        );
        assert_eq!(self.outputs, self.board.outputs());
        self.check_mode(before.mode, &messages);
        match self.board.configuration().copied() {
            None => self.check_silence(),
            Some(now) => {
                assert_eq!(now.validate(), Ok(()));
                self.check_servo(&now, &before, &messages, elapsed_us);
                self.check_esc(&now, before.mode, elapsed_us);
            }
        }
    }

    fn check_mode(&self, before: BoardMode, messages: &PollMessages) {
        use BoardMode::{Armed, Driving, EmergencyStopped, Jogging, PoweringUp};
        let mode = self.board.mode();
        let is_armed = |mode| matches!(mode, Armed | Driving | PoweringUp | Jogging);
        assert!(
            !is_armed(mode) || is_armed(before) || messages.arm,
            "{before:?} -> {mode:?} unasked"
        );
        assert!(
            mode != Driving || before == Driving || messages.drive,
            "{before:?} -> {mode:?} without a command"
        );
        assert!(
            mode != Jogging || before == Jogging || messages.jog,
            "{before:?} -> {mode:?} without pulses"
        );
        // From one to the other leads an arm request only.
        assert!(
            !matches!((before, mode), (Driving, Jogging) | (Jogging, Driving)) || messages.arm,
            "{before:?} -> {mode:?}"
        );
        assert!(
            before != EmergencyStopped || mode == EmergencyStopped,
            "left an emergency stop for {mode:?}"
        );
        match messages.last {
            Some(ToBoard::Disarm(_)) => assert!(!is_armed(mode), "disarmed and {mode:?}"),
            Some(ToBoard::EmergencyStop(_)) => assert_eq!(mode, EmergencyStopped),
            _ => {}
        }
        assert_eq!(
            matches!(mode, Driving | Jogging),
            self.outputs.drive_deadline_us.is_some()
        );
        if let Some(deadline_us) = self.outputs.drive_deadline_us {
            let left_us = deadline_us.wrapping_sub(self.now_us);
            assert!(
                left_us <= COMMAND_TIME_TO_LIVE_US,
                "a command in force for {left_us} us"
            );
        }
    }

    /// Without a configuration no actuator moves.
    fn check_silence(&self) {
        assert_eq!(self.outputs.servo_us, None);
        assert!(!self.outputs.power_on);
        if self.board.mode() != BoardMode::EmergencyStopped {
            assert_eq!(self.outputs.esc_us, Some(NEUTRAL_AT_START_US));
        }
        assert!(matches!(
            self.board.mode(),
            BoardMode::Boot | BoardMode::Neutral | BoardMode::EmergencyStopped
        ));
    }

    fn check_servo(
        &self,
        now: &Configuration,
        before: &Before,
        messages: &PollMessages,
        elapsed_us: u32,
    ) {
        let servo = &now.servo;
        let Some(pulse_us) = self.outputs.servo_us else {
            panic!("a configured board without a servo pulse");
        };
        assert!((servo.min_us..=servo.max_us).contains(&pulse_us));
        if let Some(before_us) = before.servo_us
            && before.configuration.as_ref() == Some(now)
            && !messages.configure
        {
            let allowed =
                u64::from(servo.slew_us_per_20ms) * u64::from(elapsed_us.min(20_000)) / 20_000 + 1;
            let change = u64::from(pulse_us.abs_diff(before_us));
            assert!(change <= allowed, "{change} us in {elapsed_us} us");
        }
    }

    fn check_esc(&mut self, now: &Configuration, before: BoardMode, elapsed_us: u32) {
        let (esc, mode) = (&now.esc, self.board.mode());
        let jogged = mode == BoardMode::Jogging && self.outputs.esc_us != Some(esc.neutral_us);
        self.jogged_us = match before {
            BoardMode::Jogging if jogged => self.jogged_us.saturating_add(elapsed_us),
            _ => 0,
        };
        assert!(
            self.jogged_us <= JOG_DRIVE_US + COMMAND_TIME_TO_LIVE_US,
            "jogged for {} us",
            self.jogged_us
        );
        let armed = matches!(
            mode,
            BoardMode::PoweringUp | BoardMode::Armed | BoardMode::Driving | BoardMode::Jogging
        );
        assert_eq!(self.outputs.power_on, armed && now.kill_output);
        if mode == BoardMode::EmergencyStopped {
            // The pulse of the start for a while, then none.
            let pulse_us = self.outputs.esc_us.unwrap_or(NEUTRAL_AT_START_US);
            assert_eq!(pulse_us, NEUTRAL_AT_START_US);
            assert_eq!(self.outputs.esc_neutral_us, NEUTRAL_AT_START_US);
            return;
        }
        let Some(pulse_us) = self.outputs.esc_us else {
            panic!("{mode:?} without pulses");
        };
        assert_eq!(self.outputs.esc_neutral_us, esc.neutral_us);
        assert!((esc.min_us..=esc.max_us).contains(&pulse_us));
        let brakes = esc.kind.has_brake() && pulse_us == esc.brake_us;
        if mode == BoardMode::Driving {
            self.braked_us = 0;
            assert!(
                now.speed.max_reverse_mm_s > 0 || pulse_us >= esc.neutral_us || brakes,
                "reverse"
            );
        } else if mode == BoardMode::Jogging {
            self.braked_us = 0;
            assert!(
                pulse_us.abs_diff(esc.neutral_us) <= JOG_LIMIT_US,
                "{pulse_us} us while jogging"
            );
        } else if pulse_us != esc.neutral_us {
            // Jogging ends without a brake pulse.
            assert_ne!(before, BoardMode::Jogging, "{pulse_us} us after jogging");
            // A stop brakes once, after driving, for at most half a second.
            assert!(brakes, "{pulse_us} us in {mode:?}");
            match mode {
                BoardMode::Failsafe => assert_eq!(now.failsafe, FailsafeAction::Brake),
                // Disarmed while it rolled.
                _ => assert_eq!(mode, BoardMode::Neutral),
            }
            if before != BoardMode::Driving {
                self.braked_us = self.braked_us.saturating_add(elapsed_us);
            }
            assert!(
                self.braked_us < 500 * MS,
                "braked for {} us",
                self.braked_us
            );
        }
    }
}

/// State before a poll.
struct Before {
    mode: BoardMode,
    configuration: Option<Configuration>,
    servo_us: Option<u16>,
}

/// Checks that the board sent a zero or one message to the host.
fn assert_is_frame(bytes: &[u8]) {
    if bytes == [0] {
        return;
    }
    let mut decoder = Decoder::new();
    let messages = bytes
        .iter()
        .filter_map(|&byte| decoder.push(byte).map(|packet| packet.map(ToHost::decode)));
    let messages: Vec<_> = messages.collect();
    assert!(
        matches!(messages.as_slice(), [Ok(Ok(_))]),
        "{bytes:?} is not one message"
    );
}

/// A valid configuration, with one arbitrary value.
fn any_configuration(choices: &mut Choices<'_>) -> Configuration {
    let mut configuration = CONFIGURATION;
    let Configuration {
        servo, esc, speed, ..
    } = &mut configuration;
    let value = choices.u16();
    let field = choices.byte();
    match field % 26 {
        0 => servo.centre_us = value,
        1 => servo.gain_us_per_rad = value.cast_signed(),
        2 => servo.min_us = value,
        3 => servo.max_us = value,
        4 => servo.slew_us_per_20ms = value,
        5 => esc.neutral_us = value,
        6 => esc.deadband_us = value,
        7 => esc.min_us = value,
        8 => esc.max_us = value,
        9 => esc.slew_us_per_20ms = value,
        10 => esc.brake_us = value,
        11 => speed.pulse_distance_um = value,
        12 => speed.feed_forward_us_per_m_s = value,
        13 => speed.proportional_us_per_m_s = value,
        14 => speed.integral_us_per_m = value,
        15 => speed.integral_limit_us = value,
        16 => speed.max_forward_mm_s = value,
        17 => speed.max_reverse_mm_s = value,
        18 => configuration.max_pose_age_ms = value,
        19 => configuration.max_roll_out_ms = value,
        20 => configuration.car_id = value,
        21 => configuration.kill_output = true,
        22 => esc.kind = EscKind::ForwardReverse,
        23 => {
            esc.kind = EscKind::Vesc;
            speed.max_reverse_mm_s = 0;
        }
        24 => configuration.imu_axes.up = ImuAxis::MinusZ,
        _ => configuration.stop_input = true,
    }
    if field & 0x80 != 0 {
        configuration.failsafe = FailsafeAction::Brake;
    }
    configuration
}

#[cfg(test)]
mod tests {
    use super::{Bench, BoardMode, Choices};

    #[test]
    fn the_first_byte_selects_the_initial_state() {
        for options in 0..64_u8 {
            let bench = Bench::at_stage(&mut Choices::new(&[options]));
            let expected = match options & 3 {
                0 => BoardMode::Boot,
                1 => BoardMode::Neutral,
                2 => BoardMode::Armed,
                _ => BoardMode::Driving,
            };
            assert_eq!(bench.board.mode(), expected, "{options:#08b}");
            assert_eq!(bench.board.configuration().is_some(), options & 3 != 0);
        }
    }
}
