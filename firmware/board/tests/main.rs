//! The board in virtual time.

#![allow(clippy::panic, reason = "a test that can't go on has failed")]

mod actuators;
mod arming;
mod brake;
mod commands;
mod gears;
mod invariants;
mod jogging;
mod kill_output;
mod reporting;
mod stopping;
mod watches;

use singletrack_board::{Board, Inputs, MotorPulses, Outputs};
use singletrack_protocol::{
    Arm, BoardMode, COMMAND_TIME_TO_LIVE_US, Configuration, Configure, Decoder, Disarm, Drive,
    EmergencyStop, EscCalibration, EscKind, FailsafeAction, Hello, ImuAxes, Jog,
    LONGEST_ROLL_OUT_MS, RefusalReason, ResetCause, Sequence, ServoCalibration, SpeedLoop, Status,
    Telemetry, ToBoard, ToHost, UNNAMED, VERSION,
};

pub(crate) const MS: u32 = 1_000;
pub(crate) const TTL: u32 = COMMAND_TIME_TO_LIVE_US;
pub(crate) const NEUTRAL: u16 = 1_500;
pub(crate) const SOFTWARE_VERSION: [u8; 3] = [1, 2, 3];

pub(crate) fn configuration() -> Configuration {
    Configuration {
        servo: ServoCalibration {
            centre_us: 1_480,
            gain_us_per_rad: 800,
            min_us: 1_100,
            max_us: 1_900,
            slew_us_per_20ms: 100,
        },
        esc: EscCalibration {
            kind: EscKind::Car,
            neutral_us: NEUTRAL,
            deadband_us: 20,
            min_us: 1_200,
            max_us: 1_800,
            slew_us_per_20ms: 60,
            brake_us: 1_300,
        },
        speed: SpeedLoop {
            pulse_distance_um: 5_000,
            feed_forward_us_per_m_s: 100,
            proportional_us_per_m_s: 50,
            integral_us_per_m: 100,
            integral_limit_us: 60,
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

pub(crate) struct Rig {
    pub(crate) board: Board,
    pub(crate) now: u32,
    pub(crate) inputs: Inputs,
    pub(crate) outputs: Outputs,
    /// Time between polls in [`Rig::run`].
    pub(crate) poll_us: u32,
    /// Time between motor pulses; `None` while the wheels stand still.
    pub(crate) pulse_period_us: Option<u32>,
    /// Whether the line accepts frames from the board.
    pub(crate) line_open: bool,
    /// The board's messages with the times of their polls.
    pub(crate) messages: Vec<(u32, ToHost)>,
    next_request: Sequence,
    next_drive: Sequence,
    decoder: Decoder,
}

impl Rig {
    /// A board that has just started at a given time, not yet polled.
    pub(crate) fn starting_at(now: u32) -> Self {
        let board = Board::new(ResetCause::PowerOn, SOFTWARE_VERSION, UNNAMED);
        Self {
            outputs: board.outputs(),
            board,
            now,
            inputs: Inputs::default(),
            poll_us: MS,
            pulse_period_us: None,
            line_open: true,
            messages: Vec::new(),
            next_request: Sequence(1),
            next_drive: Sequence(250),
            decoder: Decoder::new(),
        }
    }

    pub(crate) fn new() -> Self {
        Self::starting_at(1_000_000)
    }

    /// Configured and ready to arm.
    pub(crate) fn ready_with(configuration: Configuration) -> Self {
        let mut rig = Self::new();
        rig.poll(&[]);
        rig.greet(77);
        assert_eq!(rig.configure(configuration), Ok(()));
        rig.run(2_100 * MS);
        assert_eq!(rig.board.mode(), BoardMode::Neutral);
        rig
    }

    pub(crate) fn armed_with(configuration: Configuration) -> Self {
        let mut rig = Self::ready_with(configuration);
        assert_eq!(rig.arm(), Ok(()));
        rig
    }

    /// Driving forward at 1 m/s for half a second, wheels turning.
    pub(crate) fn driving_with(configuration: Configuration) -> Self {
        let mut rig = Self::armed_with(configuration);
        rig.pulse_period_us = Some(5_000);
        rig.drive_for(500 * MS, 1_000, 0);
        assert_eq!(rig.board.mode(), BoardMode::Driving);
        assert!(rig.esc_us() > NEUTRAL + 20);
        rig
    }

    /// The ESC's pulse; zero for none.
    pub(crate) fn esc_us(&self) -> u16 {
        self.outputs.esc_us.unwrap_or(0)
    }

    pub(crate) fn poll(&mut self, received: &[u8]) -> Outputs {
        if let Some(period) = self.pulse_period_us {
            while self.now.wrapping_sub(self.inputs.motor.last_edge_us) >= period {
                let MotorPulses {
                    count,
                    last_edge_us,
                } = self.inputs.motor;
                // The wheels stood still before.
                let late = self.now.wrapping_sub(last_edge_us) > 10 * period;
                self.inputs.motor = MotorPulses {
                    count: count.wrapping_add(1),
                    last_edge_us: if late {
                        self.now
                    } else {
                        last_edge_us.wrapping_add(period)
                    },
                };
            }
        }
        let (decoder, messages, now, open) = (
            &mut self.decoder,
            &mut self.messages,
            self.now,
            self.line_open,
        );
        let mut transmit = |bytes: &[u8]| {
            if !open {
                return false;
            }
            let before = messages.len();
            for &byte in bytes {
                if let Some(packet) = decoder.push(byte) {
                    match packet.map(ToHost::decode) {
                        Ok(Ok(message)) => messages.push((now, message)),
                        wrong => panic!("the board sent {wrong:?}"),
                    }
                }
            }
            // No message: the zero before the announcement.
            let whole = usize::from(bytes != [0]);
            assert_eq!(messages.len(), before + whole, "not one whole frame");
            true
        };
        self.outputs = self
            .board
            .poll(self.now, &self.inputs, received, &mut transmit);
        self.outputs
    }

    /// Advances time, polling every `poll_us`.
    pub(crate) fn run(&mut self, duration_us: u32) {
        let mut left = duration_us;
        while left > 0 {
            let step = self.poll_us.min(left);
            self.now = self.now.wrapping_add(step);
            self.poll(&[]);
            left -= step;
        }
    }

    /// Advances time by milliseconds until the condition holds, for ten seconds at most.
    pub(crate) fn run_until(&mut self, condition: impl Fn(&Self) -> bool) {
        for _ in 0..10_000 {
            if condition(self) {
                return;
            }
            self.run(MS);
        }
        panic!("the condition has never held");
    }

    /// Sends a message to the board and polls.
    pub(crate) fn send(&mut self, message: impl Into<ToBoard>) {
        self.poll(message.into().encode().as_bytes());
    }

    pub(crate) fn greet(&mut self, nonce: u32) {
        self.send(Hello {
            protocol_version: VERSION,
            software_version: [9, 9, 9],
            nonce,
        });
    }

    pub(crate) fn request(&mut self) -> Sequence {
        self.next_request = self.next_request.next();
        self.next_request
    }

    /// The board's answer to the request in the last poll.
    fn answer(&self, to: Sequence) -> Result<(), RefusalReason> {
        for &(time, message) in self.messages.iter().rev() {
            assert_eq!(time, self.now, "no answer");
            match message {
                ToHost::Acknowledgement(yes) if yes.sequence == to => return Ok(()),
                ToHost::Refusal(no) if no.sequence == to => return Err(no.reason),
                _ => {}
            }
        }
        panic!("no answer");
    }

    pub(crate) fn configure(&mut self, configuration: Configuration) -> Result<(), RefusalReason> {
        let request = self.request();
        self.send(Configure {
            request,
            configuration,
        });
        self.answer(request)
    }

    /// A valid arm request.
    pub(crate) fn arm_request(&mut self) -> Arm {
        Arm {
            request: self.request(),
            configuration_hash: self.board.configuration().map_or(1, Configuration::hash),
            telemetry_time_us: self.now,
        }
    }

    pub(crate) fn arm(&mut self) -> Result<(), RefusalReason> {
        let arm = self.arm_request();
        self.arm_as(arm)
    }

    pub(crate) fn arm_as(&mut self, arm: Arm) -> Result<(), RefusalReason> {
        self.send(arm);
        self.answer(arm.request)
    }

    pub(crate) fn disarm(&mut self) {
        let request = self.request();
        self.send(Disarm { request });
        assert_eq!(self.answer(request), Ok(()));
    }

    pub(crate) fn emergency_stop(&mut self) {
        let request = self.request();
        self.send(EmergencyStop { request });
        assert_eq!(self.answer(request), Ok(()));
    }

    /// A valid command with a pose age of 10 ms.
    pub(crate) fn command(&mut self, speed_mm_s: i16, steering_100urad: i16) -> Drive {
        self.next_drive = self.next_drive.next();
        Drive {
            sequence: self.next_drive,
            speed_mm_s,
            steering_100urad,
            telemetry_time_us: self.now,
            pose_age_ms: 10,
            brake: false,
        }
    }

    pub(crate) fn drive(&mut self, speed_mm_s: i16, steering_100urad: i16) {
        let command = self.command(speed_mm_s, steering_100urad);
        self.send(command);
    }

    /// Sends a command every 10 ms, the last one at the end.
    pub(crate) fn drive_for(&mut self, duration_us: u32, speed_mm_s: i16, steering_100urad: i16) {
        for _ in 0..duration_us / (10 * MS) {
            self.run(10 * MS);
            self.drive(speed_mm_s, steering_100urad);
        }
    }

    pub(crate) fn jog_command(&mut self, servo_us: u16, esc_us: u16) -> Jog {
        self.next_drive = self.next_drive.next();
        Jog {
            sequence: self.next_drive,
            telemetry_time_us: self.now,
            servo_us,
            esc_us,
        }
    }

    pub(crate) fn jog(&mut self, servo_us: u16, esc_us: u16) {
        let command = self.jog_command(servo_us, esc_us);
        self.send(command);
    }

    /// Sends pulses every 10 ms, the last ones at the end.
    pub(crate) fn jog_for(&mut self, duration_us: u32, servo_us: u16, esc_us: u16) {
        for _ in 0..duration_us / (10 * MS) {
            self.run(10 * MS);
            self.jog(servo_us, esc_us);
        }
    }

    /// The last telemetry record.
    pub(crate) fn telemetry(&self) -> Telemetry {
        let found = self
            .messages
            .iter()
            .rev()
            .find_map(|(_, message)| match message {
                ToHost::Telemetry(telemetry) => Some(*telemetry),
                _ => None,
            });
        found.unwrap_or_else(|| panic!("no telemetry"))
    }

    /// The next status record.
    pub(crate) fn status(&mut self) -> Status {
        self.messages.clear();
        self.run(200 * MS);
        let found = self
            .messages
            .iter()
            .rev()
            .find_map(|(_, message)| match message {
                ToHost::Status(status) => Some(*status),
                _ => None,
            });
        found.unwrap_or_else(|| panic!("no status"))
    }

    /// Sends a command that must be refused; returns the reason in [`Status`].
    pub(crate) fn refused(&mut self, command: impl Into<ToBoard>) -> RefusalReason {
        let before = self.board.last_sequence();
        self.send(command);
        assert_eq!(self.board.last_sequence(), before, "accepted");
        self.status().last_refusal
    }
}
