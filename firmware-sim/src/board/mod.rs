//! The board: the real board code on a simulated Arduino, or the real image on a
//! simulated processor.

mod image;
mod native;
#[cfg(feature = "real-time")]
mod size;

use std::collections::VecDeque;

use singletrack_board::Board;
use singletrack_control::words;
use singletrack_protocol::{
    COMMAND_TIME_TO_LIVE_US, Decoder, ResetCause, Telemetry, ToBoard, ToHost, UNNAMED,
};
use singletrack_settings::section;
use singletrack_simavr::{BusFault, Figures, Hang, Motion, Request};

use self::{image::Image, native::Native};
use crate::{
    car::Car,
    clock::SkewedClock,
    pulses::{PulseFilter, PulseLog, PulseRecord, push_bounded},
    random::{Random, Stream},
    wire::SerialWire,
};

pub use image::{Installation, UnoError};
#[cfg(feature = "real-time")]
pub use size::ImageSize;

words! {
    /// Implementation of the board.
    #[derive(Default)]
    pub enum BoardKind: serde {
        /// The board's code, compiled for this machine, with simulated pins.
        #[default]
        Native = "native",
        /// The UNO image on a simulated processor; see
        /// [`Installation`].
        Uno = "uno",
    }
}

impl core::str::FromStr for BoardKind {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::named(text).ok_or("choose native or uno")
    }
}

section! {
    /// The board's clock, start-up and buffers.
    "board" => pub BoardParameters: Copy, Eq;
    [default];

    /// Implementation of the board.
    kind: BoardKind = BoardKind::Native;
    /// Number of the car that the board is built into; the image's is built in.
    car_id: u16 = UNNAMED;
    /// Rate error of the board's clock, in ppm; positive is fast. The resonator of
    /// a UNO is within ± 5,000.
    clock_skew_ppm: i32 = 3_000;
    /// Reading of the board's clock at its start, in µs. The image's starts at
    /// zero.
    clock_offset_us: u32 = 0;
    /// Time between two rounds of the main loop, on the board's clock, in µs; not
    /// used with the image.
    poll_period_us: u64 = 1_000, in in_words("100 or more", |x| x >= 100.0);
    /// Size of the transmit buffer, in bytes; not used with the image.
    transmit_buffer: usize = 128;
    /// Size of the receive buffer, in bytes; further bytes are lost. Not used with
    /// the image.
    receive_buffer: usize = 64;
    /// Whether the board has a supply of its own; otherwise a pulled USB cable takes its power
    /// along.
    own_supply: bool = false;
    /// Start-up time after power-on, brown-out and watchdog, in µs.
    start_up_us: u64 = 65_000;
    /// Shortest and longest time in the bootloader after an external reset, in µs.
    bootloader_us: [u64; 2] = [800_000, 3_000_000];
}

/// Power and reset state of the board.
#[derive(Debug)]
enum PowerState {
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

/// The implementation of the board.
#[derive(Debug)]
enum Machine {
    Native(Box<Native>),
    Image(Box<Image>),
}

/// Connections of the board.
struct Environment<'a> {
    now_us: u64,
    started_us: u64,
    clock: SkewedClock,
    stop_input_open: bool,
    battery_noise: &'a mut Random,
    car: &'a mut Car,
    wire: &'a mut SerialWire,
    pulses: &'a mut PulseLog,
    filter: &'a mut dyn PulseFilter,
    monitor: &'a mut Monitor,
}

/// The board, running or not.
#[derive(Debug)]
pub struct SimulatedBoard {
    parameters: BoardParameters,
    clock: SkewedClock,
    bootloader: Random,
    battery_noise: Random,
    phase: PowerState,
    machine: Machine,
    /// Whether the stop switch is open.
    pub stop_input_open: bool,
    /// Number of resets since the start, without the power-on.
    pub resets: u64,
    /// The pulses on the pins.
    pub pulses: PulseLog,
    monitor: Monitor,
    received: Vec<u8>,
}

impl SimulatedBoard {
    pub(crate) fn new(parameters: BoardParameters, seed: u64) -> Result<Self, UnoError> {
        let (until_us, cause) = (parameters.start_up_us, ResetCause::PowerOn);
        let offset_us = parameters.clock_offset_us.into();
        let clock = SkewedClock::new(offset_us, parameters.clock_skew_ppm);
        Ok(Self {
            clock,
            bootloader: Random::new(seed, Stream::Bootloader),
            battery_noise: Random::new(seed, Stream::Battery),
            phase: PowerState::Starting { until_us, cause },
            machine: match parameters.kind {
                BoardKind::Native => Machine::Native(Box::new(Native::new(parameters, cause))),
                BoardKind::Uno => Machine::Image(Box::new(Image::start(clock)?)),
            },
            stop_input_open: false,
            resets: 0,
            pulses: PulseLog::default(),
            monitor: Monitor::default(),
            received: Vec::new(),
            parameters,
        })
    }

    /// Whether the board's code runs: the board is neither off nor in the bootloader.
    pub const fn is_running(&self) -> bool {
        matches!(self.phase, PowerState::Running { .. })
    }

    /// Whether the board has power, and with it its IMU.
    pub(crate) const fn has_power(&self) -> bool {
        !matches!(self.phase, PowerState::Off)
    }

    /// The board's clock, in µs, wrapping; `None` while it does not run. The
    /// image's own clock lags by up to a millisecond.
    pub fn board_time_us(&self, simulation_us: u64) -> Option<u32> {
        let PowerState::Running { started_us } = self.phase else {
            return None;
        };
        Some(local_time(&self.clock, started_us, simulation_us))
    }

    /// The native board's code, for inspection; `None` while it does not run.
    pub fn code(&self) -> Option<&Board> {
        match (&self.machine, &self.phase) {
            (Machine::Native(native), PowerState::Running { .. }) => Some(&native.board),
            _ => None,
        }
    }

    /// The last telemetry record that the board has started to send since its
    /// start.
    pub const fn telemetry(&self) -> Option<&Telemetry> {
        self.monitor.telemetry.as_ref()
    }

    /// Telemetry time of the newest command that reached the board in time since
    /// its start: board time, in µs. The time to live counts from it.
    pub const fn last_command_us(&self) -> Option<u32> {
        self.monitor.last_command_us
    }

    /// Removes the oldest message from the host that reached the board since its
    /// start. The newest 64 are kept.
    pub fn next_received(&mut self) -> Option<ReceivedMessage> {
        self.monitor.received.pop_front()
    }

    fn image(&self) -> Option<&Image> {
        match &self.machine {
            Machine::Native(_) => None,
            Machine::Image(image) => Some(image),
        }
    }

    /// Bytes lost by the image's receiver so far; zero for a native board.
    pub fn bytes_overrun(&self) -> u64 {
        self.image().map_or(0, |image| image.bytes_overrun)
    }

    /// The error that ended the simulated processor, if any; the board is then off.
    pub fn failure(&self) -> Option<&str> {
        self.image()?.failure.as_deref()
    }

    /// Cost of the image so far; `None` for a native board.
    #[must_use]
    pub fn figures(&mut self) -> Option<Figures> {
        match &mut self.machine {
            Machine::Native(_) => None,
            Machine::Image(image) => image.figures(),
        }
    }

    /// Largest deviation of one of the image's pulses from 20 ms after the previous
    /// one, in µs; `None` for a native board.
    pub fn pulse_jitter_us(&self) -> Option<f64> {
        self.image().map(Image::jitter_us)
    }

    /// Hangs the main program until the next reset. A native board has no watchdog
    /// and treats both kinds alike: supervising interrupt and pulses continue.
    pub fn hang(&mut self, hang: Hang) {
        match &mut self.machine {
            Machine::Native(native) => native.hung = true,
            Machine::Image(image) => drop(image.ask(&Request::Hang(hang))),
        }
    }

    /// Sets the fault of the image's IMU bus. A native board has no bus: every
    /// fault except `None` silences its IMU.
    pub fn set_imu_bus(&mut self, fault: BusFault) {
        match &mut self.machine {
            Machine::Native(native) => native.imu_is_silent = fault != BusFault::None,
            Machine::Image(image) => drop(image.ask(&Request::SetBus(fault))),
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
        let until_us = now_us + duration;
        self.leave(now_us, PowerState::Starting { until_us, cause }, car);
    }

    pub(crate) fn set_power(&mut self, now_us: u64, on: bool, car: &mut Car) {
        if on && !self.has_power() {
            let until_us = now_us + self.parameters.start_up_us;
            let cause = ResetCause::PowerOn;
            self.phase = PowerState::Starting { until_us, cause };
        } else if !on && self.has_power() {
            self.leave(now_us, PowerState::Off, car);
        }
    }

    /// Leaves the running state; the pins float.
    fn leave(&mut self, now_us: u64, phase: PowerState, car: &mut Car) {
        let board_time_us = self.board_time_us(now_us).unwrap_or(0);
        self.phase = phase;
        self.monitor = Monitor::default();
        // The pin floats, and its pull-down holds it.
        car.set_kill_output(false);
        if let Machine::Image(image) = &mut self.machine {
            image.hold(car, &mut self.pulses);
        }
        self.pulses.push(PulseRecord {
            time_us: now_us,
            board_time_us,
            ..PulseRecord::default()
        });
    }

    pub(crate) fn next_event_us(&self) -> u64 {
        match self.phase {
            PowerState::Off => u64::MAX,
            PowerState::Starting { until_us, .. } => until_us,
            PowerState::Running { .. } => match &self.machine {
                Machine::Native(native) => native.next_event_us,
                Machine::Image(image) => image.next_event_us,
            },
        }
    }

    pub(crate) fn take_imu(&mut self, now_us: u64, reading: Motion) {
        match (self.board_time_us(now_us), &mut self.machine) {
            (Some(board_time_us), Machine::Native(native)) => {
                native.take_imu(board_time_us, reading);
            }
            (None, Machine::Native(_)) => {}
            // The sensor measures even if the board does not run.
            (_, Machine::Image(image)) => image.take_imu(now_us, reading),
        }
    }

    pub(crate) fn events_at(
        &mut self,
        now_us: u64,
        car: &mut Car,
        wire: &mut SerialWire,
        filter: &mut dyn PulseFilter,
    ) {
        if let PowerState::Starting { until_us, cause } = self.phase
            && until_us <= now_us
        {
            // Bytes received during the bootloader are lost.
            self.received.clear();
            wire.board_read(now_us, &mut self.received);
            match &mut self.machine {
                Machine::Native(native) => native.restart(cause),
                Machine::Image(image) => image.restart(now_us, cause),
            }
            self.phase = PowerState::Running { started_us: now_us };
        }
        let PowerState::Running { started_us } = self.phase else {
            return;
        };
        let mut environment = Environment {
            now_us,
            started_us,
            clock: self.clock,
            stop_input_open: self.stop_input_open,
            battery_noise: &mut self.battery_noise,
            car,
            wire,
            pulses: &mut self.pulses,
            filter,
            monitor: &mut self.monitor,
        };
        let watchdog_reset = match &mut self.machine {
            Machine::Native(native) => {
                native.run(environment);
                false
            }
            Machine::Image(image) => image.run(&mut environment),
        };
        if self.failure().is_some() {
            self.leave(now_us, PowerState::Off, car);
        } else if watchdog_reset {
            self.reset(now_us, ResetCause::Watchdog, car);
        }
    }
}

/// Board time; the clock restarts with the board.
fn local_time(clock: &SkewedClock, started_us: u64, simulation_us: u64) -> u32 {
    clock.at(simulation_us.saturating_sub(started_us)) as u32
}

/// The voltage at the battery's terminals. A floating input shows anything: half of the
/// supply at the pin.
fn battery_mv(car: &Car, noise: &mut Random) -> u16 {
    let p = &car.parameters.battery;
    if p.divider_open {
        return supply_mv(car);
    }
    let volts = car.battery_v() + noise.normal() * p.noise_v;
    (volts * 1e3).round() as u16
}

fn supply_mv(car: &Car) -> u16 {
    (car.parameters.battery.supply_v * 1e3).round() as u16
}

/// A message of the host that reached the board, accepted or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceivedMessage {
    /// Simulation time, in µs.
    pub time_us: u64,
    /// Board time, in µs, wrapping.
    pub board_time_us: u32,
    /// The decoded message.
    pub message: ToBoard,
}

/// Number of messages kept.
const CAPACITY: usize = 64;

/// Decodes both directions.
#[derive(Debug, Default)]
struct Monitor {
    inbound: Decoder,
    outbound: Decoder,
    telemetry: Option<Telemetry>,
    last_command_us: Option<u32>,
    received: VecDeque<ReceivedMessage>,
}

impl Monitor {
    /// Processes a byte to the board.
    fn host_byte(&mut self, byte: u8, time_us: u64, board_time_us: u32) {
        let packet = self.inbound.push(byte);
        let Some(Ok(Ok(message))) = packet.map(|packet| packet.map(ToBoard::decode)) else {
            return;
        };
        let received = ReceivedMessage {
            time_us,
            board_time_us,
            message,
        };
        push_bounded(&mut self.received, received, CAPACITY);
        let telemetry_time_us = match message {
            ToBoard::Drive(drive) => drive.telemetry_time_us,
            ToBoard::Jog(jog) => jog.telemetry_time_us,
            _ => return,
        };
        // Other commands are refused.
        if board_time_us.wrapping_sub(telemetry_time_us) <= COMMAND_TIME_TO_LIVE_US {
            self.last_command_us = Some(telemetry_time_us);
        }
    }

    /// Processes a byte from the board.
    fn board_byte(&mut self, byte: u8) {
        if let Some(Ok(packet)) = self.outbound.push(byte)
            && let Ok(ToHost::Telemetry(telemetry)) = ToHost::decode(packet)
        {
            self.telemetry = Some(telemetry);
        }
    }
}
