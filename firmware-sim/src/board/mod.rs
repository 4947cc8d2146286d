//! The board: the real board code on a simulated Arduino, or the real image on
//! a simulated processor.

mod frames;
mod image;
mod monitor;
mod native;
mod process;
mod size;

use serde::{Deserialize, Serialize};
use singletrack_board::Board;
use singletrack_protocol::{ResetCause, Telemetry};
use singletrack_simavr::{BusFault, Figures, Hang};

pub use image::{Installation, UnoError};
pub use monitor::Heard;
pub use size::ImageSize;

use crate::{
    car::{BatteryParameters, Car, ImuReading},
    clock::SkewedClock,
    pulse_log::{PulseLog, PulseRecord},
    random::{Random, Stream},
    wire::SerialWire,
};
use image::Image;
use monitor::Monitor;
use native::Native;

/// Time from one servo pulse to the next, on the board's clock, in µs.
pub const SERVO_FRAME_US: u64 = 20_000;

/// What runs on the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoardKind {
    /// The board's code, compiled for this machine, with simulated pins.
    #[default]
    Native,
    /// The image for the Arduino UNO on a simulated processor; see
    /// [`Installation`].
    Uno,
}

/// A kind of board that there is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("choose native or uno")]
pub struct UnknownBoard;

impl core::str::FromStr for BoardKind {
    type Err = UnknownBoard;

    fn from_str(text: &str) -> Result<Self, UnknownBoard> {
        match text {
            "native" => Ok(Self::Native),
            "uno" => Ok(Self::Uno),
            _ => Err(UnknownBoard),
        }
    }
}

impl core::fmt::Display for BoardKind {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str(match self {
            Self::Native => "native",
            Self::Uno => "uno",
        })
    }
}

/// The board's clock, start-up and buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoardParameters {
    /// What runs on it.
    pub kind: BoardKind,
    /// What the board's clock gains, in µs per second. A UNO's resonator is
    /// good for ± 5,000.
    pub clock_skew_ppm: i32,
    /// What the board's clock shows when the board starts, in µs. The image's
    /// starts at zero.
    pub clock_offset_us: u32,
    /// Time between two rounds of the main loop, on the board's clock, in µs;
    /// the image has its own.
    pub poll_period_us: u64,
    /// Room for bytes that wait for the line; the image has its own.
    pub transmit_buffer: usize,
    /// Room for bytes that wait for the main loop, what comes on top is lost;
    /// the image has its own.
    pub receive_buffer: usize,
    /// Start-up time after power-on, brown-out and watchdog, in µs.
    pub start_up_us: u64,
    /// Shortest and longest time in the bootloader after an external reset, in µs.
    pub bootloader_us: [u64; 2],
}

impl Default for BoardParameters {
    fn default() -> Self {
        Self {
            kind: BoardKind::Native,
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
    Running {
        started_us: u64,
    },
}

/// What runs while it runs.
#[derive(Debug)]
enum Machine {
    Native(Box<Native>),
    Image(Box<Image>),
}

/// What surrounds the board.
struct Surroundings<'a> {
    now_us: u64,
    started_us: u64,
    clock: SkewedClock,
    stop_input_open: bool,
    battery_noise: &'a mut Random,
    car: &'a mut Car,
    wire: &'a mut SerialWire,
    pulses: &'a mut PulseLog,
    monitor: &'a mut Monitor,
}

/// The board, running or not.
#[derive(Debug)]
pub struct SimulatedBoard {
    parameters: BoardParameters,
    clock: SkewedClock,
    bootloader: Random,
    battery_noise: Random,
    phase: Phase,
    machine: Machine,
    stop_input_open: bool,
    resets: u64,
    pulses: PulseLog,
    monitor: Monitor,
    received: Vec<u8>,
}

impl SimulatedBoard {
    pub(crate) fn new(parameters: BoardParameters, seed: u64) -> Result<Self, UnoError> {
        Ok(Self {
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
            machine: match parameters.kind {
                BoardKind::Native => Machine::Native(Box::new(Native::new(parameters))),
                BoardKind::Uno => Machine::Image(Box::new(Image::start(&Installation::find()?)?)),
            },
            stop_input_open: false,
            resets: 0,
            pulses: PulseLog::default(),
            monitor: Monitor::default(),
            received: Vec::new(),
            parameters,
        })
    }

    /// Whether the board's code runs: not off, not in the bootloader.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// Resets since the start, power-on not counted.
    #[must_use]
    pub const fn resets(&self) -> u64 {
        self.resets
    }

    /// What the board's clock shows, in µs, wrapping; `None` while it does not
    /// run. The image's own is up to a millisecond behind.
    #[must_use]
    pub fn board_time_us(&self, simulation_us: u64) -> Option<u32> {
        match self.phase {
            Phase::Running { started_us } => {
                Some(local_time(&self.clock, started_us, simulation_us))
            }
            _ => None,
        }
    }

    /// The native board's code, to look into; `None` while it does not run.
    #[must_use]
    pub fn code(&self) -> Option<&Board> {
        match (&self.machine, &self.phase) {
            (Machine::Native(native), Phase::Running { .. }) => Some(native.code()),
            _ => None,
        }
    }

    /// The last telemetry record that the board has begun to send since it
    /// started.
    #[must_use]
    pub const fn telemetry(&self) -> Option<&Telemetry> {
        self.monitor.telemetry()
    }

    /// Of the commands that have reached the board in time since it started,
    /// the newest one's telemetry time, from which on it lives: board time, in µs.
    #[must_use]
    pub const fn last_command_us(&self) -> Option<u32> {
        self.monitor.last_command_us()
    }

    /// The next message of the host that has reached the board since it started,
    /// oldest first. The newest 64 are kept.
    pub fn next_heard(&mut self) -> Option<Heard> {
        self.monitor.next_heard()
    }

    /// The pulses on the pins.
    #[must_use]
    pub const fn pulses(&self) -> &PulseLog {
        &self.pulses
    }

    /// Bytes that found the image's receiver full so far; zero for a native board.
    #[must_use]
    pub fn bytes_overrun(&self) -> u64 {
        match &self.machine {
            Machine::Native(_) => 0,
            Machine::Image(image) => image.bytes_overrun(),
        }
    }

    /// Why the simulated processor has gone, if it has: the board is off then.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        match &self.machine {
            Machine::Native(_) => None,
            Machine::Image(image) => image.failure(),
        }
    }

    /// What the image has cost so far; `None` for a native board.
    #[must_use]
    pub fn figures(&mut self) -> Option<Figures> {
        match &mut self.machine {
            Machine::Native(_) => None,
            Machine::Image(image) => image.figures(),
        }
    }

    /// How far one of the image's pulses has at most come from its place, 20 ms
    /// after the one before, in µs; `None` for a native board.
    #[must_use]
    pub fn pulse_jitter_us(&self) -> Option<f64> {
        match &self.machine {
            Machine::Native(_) => None,
            Machine::Image(image) => Some(image.jitter_us()),
        }
    }

    /// Opens the stop switch or closes it.
    pub const fn set_stop_input_open(&mut self, open: bool) {
        self.stop_input_open = open;
    }

    /// Stops the main program until the next reset. A native board has no
    /// watchdog that would bring one, and treats both kinds alike: supervising
    /// interrupt and pulses go on.
    pub fn hang(&mut self, hang: Hang) {
        match &mut self.machine {
            Machine::Native(native) => native.hang(),
            Machine::Image(image) => image.hang(hang),
        }
    }

    /// Breaks the image's bus to the IMU, or mends it. A native board has none:
    /// every fault but none silences its IMU.
    pub fn set_imu_bus(&mut self, fault: BusFault) {
        match &mut self.machine {
            Machine::Native(native) => native.silence_imu(fault != BusFault::None),
            Machine::Image(image) => image.set_bus(fault),
        }
    }

    pub(crate) fn reset(&mut self, now_us: u64, cause: ResetCause, car: &mut Car) {
        let duration = match cause {
            ResetCause::External => {
                let [shortest, longest] = self.parameters.bootloader_us;
                let span = longest.saturating_sub(shortest) as f64;
                shortest + (self.bootloader.uniform() * span) as u64
            }
            _ => self.parameters.start_up_us,
        };
        self.resets += 1;
        self.leave(
            now_us,
            Phase::Starting {
                until_us: now_us + duration,
                cause,
            },
            car,
        );
    }

    pub(crate) fn set_power(&mut self, now_us: u64, on: bool, car: &mut Car) {
        match (&self.phase, on) {
            (Phase::Off, true) => {
                self.phase = Phase::Starting {
                    until_us: now_us + self.parameters.start_up_us,
                    cause: ResetCause::PowerOn,
                };
            }
            (Phase::Starting { .. } | Phase::Running { .. }, false) => {
                self.leave(now_us, Phase::Off, car);
            }
            _ => {}
        }
    }

    /// The pins float from now on.
    fn leave(&mut self, now_us: u64, phase: Phase, car: &mut Car) {
        let board_time_us = self.board_time_us(now_us).unwrap_or(0);
        self.phase = phase;
        self.monitor = Monitor::default();
        if let Machine::Image(image) = &mut self.machine {
            image.hold(&self.clock, car, &mut self.pulses);
        }
        self.pulses.push(PulseRecord {
            time_us: now_us,
            board_time_us,
            servo_us: 0,
            esc_us: 0,
            cut: false,
        });
    }

    pub(crate) fn next_event_us(&self) -> u64 {
        match self.phase {
            Phase::Off => u64::MAX,
            Phase::Starting { until_us, .. } => until_us,
            Phase::Running { started_us } => match &self.machine {
                Machine::Native(native) => native.next_event_us(&self.clock, started_us),
                Machine::Image(image) => image.next_event_us(),
            },
        }
    }

    pub(crate) fn take_imu(&mut self, now_us: u64, reading: &ImuReading) {
        match &mut self.machine {
            Machine::Native(native) => {
                if let Phase::Running { started_us } = self.phase {
                    native.take_imu(local_time(&self.clock, started_us, now_us), reading);
                }
            }
            // The sensor measures whether somebody listens or not.
            Machine::Image(image) => image.take_imu(self.clock.cycle_at(now_us), reading),
        }
    }

    pub(crate) fn events_at(&mut self, now_us: u64, car: &mut Car, wire: &mut SerialWire) {
        if let Phase::Starting { until_us, cause } = self.phase
            && until_us <= now_us
        {
            // What came during the bootloader is gone.
            self.received.clear();
            wire.board_read(now_us, &mut self.received);
            match &mut self.machine {
                Machine::Native(native) => native.restart(cause),
                Machine::Image(image) => image.restart(self.clock, now_us, cause),
            }
            self.phase = Phase::Running { started_us: now_us };
        }
        let Phase::Running { started_us } = self.phase else {
            return;
        };
        let mut around = Surroundings {
            now_us,
            started_us,
            clock: self.clock,
            stop_input_open: self.stop_input_open,
            battery_noise: &mut self.battery_noise,
            car,
            wire,
            pulses: &mut self.pulses,
            monitor: &mut self.monitor,
        };
        let bitten = match &mut self.machine {
            Machine::Native(native) => {
                native.run(around);
                false
            }
            Machine::Image(image) => image.run(&mut around),
        };
        if self.failure().is_some() {
            self.leave(now_us, Phase::Off, car);
        } else if bitten {
            self.reset(now_us, ResetCause::Watchdog, car);
        }
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
