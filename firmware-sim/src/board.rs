//! The Arduino around the real board code: clock, bytes, pins, resets.

use serde::{Deserialize, Serialize};
use singletrack_board::{Board, ImuSample, Inputs, MotorPulses};
use singletrack_protocol::ResetCause;

use crate::{
    car::{BatteryParameters, Car, ImuReading},
    clock::SkewedClock,
    pulse_log::{PulseLog, PulseRecord},
    random::{Random, Stream},
    wire::SerialWire,
};

/// Time from one servo pulse to the next, on the board's clock, in µs.
pub const SERVO_FRAME_US: u64 = 20_000;

/// The board's clock, start-up and buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoardParameters {
    /// What the board's clock gains, in µs per second. A UNO's resonator is
    /// good for ± 5,000.
    pub clock_skew_ppm: i32,
    /// What the board's clock shows when the board starts, in µs.
    pub clock_offset_us: u32,
    /// Time between two rounds of the main loop, on the board's clock, in µs.
    pub poll_period_us: u64,
    /// Room for bytes that wait for the line.
    pub transmit_buffer: usize,
    /// Room for bytes that wait for the main loop; what comes on top is lost.
    pub receive_buffer: usize,
    /// Start-up time after power-on, brown-out and watchdog, in µs.
    pub start_up_us: u64,
    /// Shortest and longest time in the bootloader after an external reset, in µs.
    pub bootloader_us: [u64; 2],
}

impl Default for BoardParameters {
    fn default() -> Self {
        Self {
            clock_skew_ppm: 3_000,
            clock_offset_us: 0,
            poll_period_us: 1_000,
            transmit_buffer: 128,
            receive_buffer: 64,
            start_up_us: 65_000,
            bootloader_us: [800_000, 3_000_000],
        }
    }
}

/// What the board is doing.
#[derive(Debug)]
enum Phase {
    Off,
    /// In the bootloader: pins float, the line is silent.
    Starting {
        until_us: u64,
        cause: ResetCause,
    },
    Running(Box<Running>),
}

#[derive(Debug)]
struct Running {
    board: Board,
    started_us: u64,
    /// Rounds of the main loop and servo frames so far.
    polls: u64,
    frames: u64,
    inputs: Inputs,
}

/// The version that the simulated board reports: this crate's.
const SOFTWARE_VERSION: [u8; 3] = [0, 1, 0];

/// The Arduino around the real board code.
#[derive(Debug)]
pub struct SimulatedBoard {
    parameters: BoardParameters,
    clock: SkewedClock,
    bootloader: Random,
    battery_noise: Random,
    phase: Phase,
    stop_input_open: bool,
    hung: bool,
    resets: u64,
    pulses: PulseLog,
    received: Vec<u8>,
}

impl SimulatedBoard {
    pub(crate) fn new(parameters: BoardParameters, seed: u64) -> Self {
        Self {
            clock: SkewedClock::new(
                u64::from(parameters.clock_offset_us),
                parameters.clock_skew_ppm,
            ),
            bootloader: Random::new(seed, Stream::Bootloader),
            battery_noise: Random::new(seed, Stream::Battery),
            phase: Phase::Starting {
                until_us: parameters.start_up_us,
                cause: ResetCause::PowerOn,
            },
            stop_input_open: false,
            hung: false,
            resets: 0,
            pulses: PulseLog::default(),
            received: Vec::new(),
            parameters,
        }
    }

    /// Whether the board's code runs: not off, not in the bootloader.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running(_))
    }

    /// Resets since the start, power-on not counted.
    #[must_use]
    pub const fn resets(&self) -> u64 {
        self.resets
    }

    /// What the board's clock shows, in µs, wrapping; `None` while it does not run.
    #[must_use]
    pub fn board_time_us(&self, simulation_us: u64) -> Option<u32> {
        match &self.phase {
            Phase::Running(running) => {
                Some(local_time(&self.clock, running.started_us, simulation_us))
            }
            _ => None,
        }
    }

    /// The board's code, to look into; `None` while it does not run.
    #[must_use]
    pub fn code(&self) -> Option<&Board> {
        match &self.phase {
            Phase::Running(running) => Some(&running.board),
            _ => None,
        }
    }

    /// The pulses on the pins.
    #[must_use]
    pub const fn pulses(&self) -> &PulseLog {
        &self.pulses
    }

    /// Opens the stop switch or closes it.
    pub const fn set_stop_input_open(&mut self, open: bool) {
        self.stop_input_open = open;
    }

    /// Stops the main loop, or lets it go on; the supervising interrupt and
    /// the pulses continue.
    pub const fn set_hung(&mut self, hung: bool) {
        self.hung = hung;
    }

    pub(crate) fn reset(&mut self, now_us: u64, cause: ResetCause) {
        let duration = match cause {
            ResetCause::External => {
                let [shortest, longest] = self.parameters.bootloader_us;
                let span = longest.saturating_sub(shortest) as f64;
                shortest + (self.bootloader.uniform() * span) as u64
            }
            _ => self.parameters.start_up_us,
        };
        self.resets += 1;
        self.hung = false;
        self.leave(
            now_us,
            Phase::Starting {
                until_us: now_us + duration,
                cause,
            },
        );
    }

    pub(crate) fn set_power(&mut self, now_us: u64, on: bool) {
        match (&self.phase, on) {
            (Phase::Off, true) => {
                self.phase = Phase::Starting {
                    until_us: now_us + self.parameters.start_up_us,
                    cause: ResetCause::PowerOn,
                };
            }
            (Phase::Starting { .. } | Phase::Running(_), false) => {
                self.leave(now_us, Phase::Off);
            }
            _ => {}
        }
    }

    /// The pins float from now on.
    fn leave(&mut self, now_us: u64, phase: Phase) {
        let board_time_us = self.board_time_us(now_us).unwrap_or(0);
        self.phase = phase;
        self.pulses.push(PulseRecord {
            time_us: now_us,
            board_time_us,
            servo_us: 0,
            esc_us: 0,
        });
    }

    pub(crate) fn next_event_us(&self) -> u64 {
        match &self.phase {
            Phase::Off => u64::MAX,
            Phase::Starting { until_us, .. } => *until_us,
            Phase::Running(running) => {
                let when = |elapsed| running.started_us + self.clock.when_elapsed(elapsed);
                when(running.polls * self.parameters.poll_period_us)
                    .min(when(running.frames * SERVO_FRAME_US))
            }
        }
    }

    pub(crate) fn take_imu(&mut self, now_us: u64, reading: &ImuReading) {
        if let Phase::Running(running) = &mut self.phase {
            running.inputs.imu = Some(ImuSample {
                time_us: local_time(&self.clock, running.started_us, now_us),
                linear_acceleration_mm_s2: reading.linear_acceleration_mm_s2,
                angular_velocity_mrad_s: reading.angular_velocity_mrad_s,
                attitude_q14: reading.attitude_q14,
            });
        }
    }

    pub(crate) fn events_at(&mut self, now_us: u64, car: &mut Car, wire: &mut SerialWire) {
        match &mut self.phase {
            Phase::Off => {}
            Phase::Starting { until_us, cause } => {
                if *until_us <= now_us {
                    // What came during the bootloader is gone.
                    self.received.clear();
                    wire.board_read(now_us, &mut self.received);
                    self.phase = Phase::Running(Box::new(Running {
                        board: Board::new(*cause, SOFTWARE_VERSION),
                        started_us: now_us,
                        polls: 0,
                        frames: 0,
                        inputs: Inputs::default(),
                    }));
                    self.run(now_us, car, wire);
                }
            }
            Phase::Running(_) => self.run(now_us, car, wire),
        }
    }

    fn run(&mut self, now_us: u64, car: &mut Car, wire: &mut SerialWire) {
        let Phase::Running(running) = &mut self.phase else {
            return;
        };
        let clock = &self.clock;
        let board_time_us = local_time(clock, running.started_us, now_us);
        let elapsed = clock.at(now_us - running.started_us) - clock.at(0);
        if running.polls * self.parameters.poll_period_us <= elapsed {
            running.polls = elapsed / self.parameters.poll_period_us + 1;
            if !self.hung {
                running.sense(clock, car, &mut self.battery_noise);
                running.inputs.stop_input_open = self.stop_input_open;
                self.received.clear();
                wire.board_read(now_us, &mut self.received);
                let room = self.parameters.receive_buffer;
                let lost = self.received.len().saturating_sub(room);
                self.received.truncate(room);
                running.inputs.bytes_overrun =
                    running.inputs.bytes_overrun.wrapping_add(lost as u16);
                let room = self.parameters.transmit_buffer;
                running.board.poll(
                    board_time_us,
                    &running.inputs,
                    &self.received,
                    &mut |frame: &[u8]| {
                        let fits = wire.board_backlog(now_us) + frame.len() <= room;
                        if fits {
                            wire.board_write(now_us, frame);
                        }
                        fits
                    },
                );
            }
        }
        if running.frames * SERVO_FRAME_US <= elapsed {
            running.frames = elapsed / SERVO_FRAME_US + 1;
            let (servo_us, esc_us) = running.pulses(board_time_us);
            car.apply_pulses(servo_us, esc_us);
            self.pulses.push(PulseRecord {
                time_us: now_us,
                board_time_us,
                servo_us,
                esc_us,
            });
        }
    }
}

impl Running {
    /// Reads the sensors that are polled.
    fn sense(&mut self, clock: &SkewedClock, car: &Car, battery_noise: &mut Random) {
        let pulses = car.motor_pulses();
        let last_us = pulses.last_us.unwrap_or(0);
        self.inputs.motor = MotorPulses {
            count: pulses.count,
            last_edge_us: local_time(clock, self.started_us, last_us),
        };
        self.inputs.battery_mv = battery_mv(car, &car.parameters().battery, battery_noise);
    }

    /// What the pins show, with the timer interrupt's last word: once the
    /// command has run out, neutral, whether the main loop is alive or not.
    fn pulses(&self, board_time_us: u32) -> (u16, u16) {
        let outputs = self.board.outputs();
        let expired = outputs
            .drive_deadline_us
            .is_some_and(|deadline| board_time_us.wrapping_sub(deadline) as i32 > 0);
        let esc_us = if expired {
            outputs.esc_neutral_us
        } else {
            outputs.esc_us
        };
        (outputs.servo_us.unwrap_or(0), esc_us)
    }
}

/// The board's clock starts anew with the board.
fn local_time(clock: &SkewedClock, started_us: u64, simulation_us: u64) -> u32 {
    clock.at(simulation_us.saturating_sub(started_us)) as u32
}

fn battery_mv(car: &Car, p: &BatteryParameters, noise: &mut Random) -> u16 {
    let volts = car.truth().battery_v + noise.normal() * p.noise_v;
    (volts * 1e3).round() as u16
}
