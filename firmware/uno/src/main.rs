//! The Arduino UNO's image.
//!
//! The firmware's logic is in [`singletrack_board`]. This crate contains the
//! drivers for the ATmega328P's pins, timers and interrupts, and the main loop.
//!
//! | Pin | Function |
//! |---|---|
//! | D0, D1 | line to the host |
//! | D2 | pulses of the motor |
//! | D4 | stop switch to ground, normally closed |
//! | D7 | kill output: the ESC's supply |
//! | D9 | servo |
//! | D10 | ESC |
//! | A0 | battery, halved |
//! | A4, A5 | IMU |

#![no_std]
#![no_main]
#![feature(abi_avr_interrupt, asm_experimental_arch)]

mod battery;
mod bno055;
mod clock;
mod interrupts;
mod motor;
mod pulse_guard;
mod pulses;
mod registers;
mod reset;
mod shared;
mod twi;
mod uart;

use core::panic::PanicInfo;

use singletrack_board::{Board, ImuHealth, Inputs, MotorPulses, VERSION};
use singletrack_protocol::{ResetCause, UNNAMED};

use crate::{
    battery::Battery,
    bno055::Bno055,
    motor::Motor,
    pulse_guard::Pace,
    registers::{ACSR, PIND, PORTD, SMCR},
    shared::InPlace,
    uart::Receiver,
};

/// Time between two rounds of the main loop, in ms, which are ticks of the
/// pulse guard. Every second round polls the board, which works in steps of 10 ms; a
/// frame from the host or a change of the stop switch polls it at once.
const ROUND_MS: u8 = 5;

/// Maximum number of received bytes per poll. More are waiting only after a delay,
/// and are then spread over several polls.
const RECEIVED_PER_POLL: usize = 64;

/// Number of the section around a poll; see [`shared::measured`].
const POLL: u8 = 1;

/// The car that this image is for: given to the build, see `cargo uno --car-id`.
const CAR_ID: u16 = match option_env!("SINGLETRACK_CAR_ID") {
    Some(digits) => number(digits),
    None => UNNAMED,
};

/// State of the main loop, besides the board. (Separate, because it is initialised
/// to zeros, which take no flash.)
struct MainLoop {
    inputs: Inputs,
    motor: Motor,
    battery: Battery,
    imu: Bno055,
    receiver: Receiver,
    buffer: [u8; RECEIVED_PER_POLL],
    /// Whether the next periodic round polls the board.
    polls_next: bool,
}

static BOARD: InPlace<Board> = InPlace::new(Board::new(ResetCause::Unknown, VERSION, CAR_ID));

static MAIN_LOOP: InPlace<MainLoop> = InPlace::new(MainLoop {
    inputs: Inputs {
        motor: MotorPulses {
            count: 0,
            last_edge_us: 0,
        },
        imu: None,
        battery_mv: 0,
        stop_input_open: false,
        bytes_overrun: 0,
        imu_errors: 0,
        supply_mv: 0,
        battery_open: false,
        imu_health: ImuHealth {
            calibration: 0,
            self_test: 0,
            status: 0,
            error: 0,
        },
        edges_refused: 0,
    },
    motor: Motor::new(),
    battery: Battery::new(),
    imu: Bno055::new(),
    receiver: Receiver::new(),
    buffer: [0; RECEIVED_PER_POLL],
    polls_next: false,
});

/// Entered from the C runtime's start-up code.
#[allow(unsafe_code)]
// SAFETY: the name is the one that the start-up code calls, and nothing else has it.
#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    start_peripherals();
    // SAFETY: `main` is called only once.
    let (board, main_loop) = unsafe { (BOARD.take(), MAIN_LOOP.take()) };
    board.set_reset_cause(reset::cause());
    interrupts::enable();
    let mut pace = Pace::new();
    loop {
        if !pace.wait(ROUND_MS, || main_loop.has_news()) || main_loop.round() {
            main_loop.poll(board);
            if let Some(proof) = pulse_guard::guarded() {
                reset::feed(proof);
            }
        }
    }
}

impl MainLoop {
    /// Whether there is work that must not wait for the next round.
    fn has_news(&self) -> bool {
        uart::has_frame() || uart::is_filling() || stop_is_open() != self.inputs.stop_input_open
    }

    /// Runs the periodic drivers; returns whether this round polls the board.
    fn round(&mut self) -> bool {
        self.imu.poll(clock::tick_us(), &mut self.inputs.imu);
        self.inputs.imu_errors = self.imu.errors();
        self.inputs.imu_health = self.imu.health();
        self.battery.poll();
        self.inputs.battery_mv = self.battery.millivolts;
        self.inputs.supply_mv = self.battery.supply_mv;
        self.inputs.battery_open = self.battery.open;
        self.polls_next = !self.polls_next;
        self.polls_next
    }

    fn poll(&mut self, board: &mut Board) {
        let now_us = clock::tick_us();
        let received = self.receiver.receive(&mut self.buffer);
        self.inputs.motor = self.motor.poll(clock::now_us());
        self.inputs.stop_input_open = stop_is_open();
        self.inputs.bytes_overrun = self.receiver.bytes_lost();
        self.inputs.edges_refused = motor::refused();
        let outputs = shared::measured(POLL, || {
            board.poll(now_us, &self.inputs, received, &mut uart::transmit)
        });
        pulse_guard::publish(now_us, &outputs);
        if let Some(configuration) = board.configuration() {
            reset::is_known();
            self.imu.mount(configuration.imu_axes);
        }
    }
}

fn start_peripherals() {
    const SLEEP_IN_IDLE: u8 = 1;
    const COMPARATOR_OFF: u8 = 1 << 7;

    // First, so that the ESC gets pulses as early as possible.
    pulse_guard::start();
    uart::start();
    motor::start();
    battery::start();
    twi::start();
    start_stop_input();
    ACSR.write(COMPARATOR_OFF);
    SMCR.write(SLEEP_IN_IDLE);
}

/// Parses a decimal number below 2^16, at compile time.
const fn number(digits: &str) -> u16 {
    let mut value = 0;
    let mut rest = digits.as_bytes();
    while let [digit, tail @ ..] = rest {
        value = value * 10 + (*digit - b'0') as u16;
        rest = tail;
    }
    value
}

/// Port D, bit 4: the stop switch, normally closed, to ground. A broken wire acts like an open
/// switch.
const STOP: u8 = 1 << 4;

fn start_stop_input() {
    PORTD.set(STOP);
}

fn stop_is_open() -> bool {
    PIND.has(STOP)
}

/// No panic is known to be possible; if one occurs, the car stops.
///
/// Drops the ESC's supply, ends the pulses, which makes servo and ESC let go, and waits
/// for the watchdog.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    interrupts::masked(|masked| {
        pulses::set_supply(masked, false);
        pulses::stop(masked);
    });
    interrupts::disable();
    loop {}
}
