//! The last word on the pulses, spoken by the 1 kHz interrupt.
//!
//! The main loop says what it wants and until when; only the interrupt writes
//! it to the timer. It puts the ESC to neutral by itself when the time is up,
//! and when the main loop has not said anything for [`PATIENCE_TICKS`].
#![allow(unsafe_code)]

use singletrack_board::Outputs;

use crate::clock;
use crate::interrupts::{self, Masked, Shared, SharedByte, masked};
use crate::pulses::{self, Width};

/// A main loop that has been silent for more ticks hangs. (With a servo period
/// of 20 ms on top, the neutral pulse is out within 45 ms.)
const PATIENCE_TICKS: u8 = 19;

/// What every ESC takes for neutral: shown until the board says something.
const NEUTRAL_AT_START: Width = Width::from_us(1_500);

// What the main loop wants. (Not one structure: the compiler would pick it to
// pieces with 64-bit shifts.)
static SERVO: Shared<Option<Width>> = Shared::new(None);
static ESC: Shared<Width> = Shared::new(NEUTRAL_AT_START);
static NEUTRAL: Shared<Width> = Shared::new(NEUTRAL_AT_START);
/// Ticks for which `ESC` may be shown without hearing from the main loop.
static PATIENCE: SharedByte = SharedByte::new(0);

/// Ticks since the main loop last said what it wants; stops at 255.
static SILENT_TICKS: SharedByte = SharedByte::new(0);

/// Ticks so far, wrapping: the pace of the main loop.
static TICKS: SharedByte = SharedByte::new(0);

/// Not zero: the main loop should look what there is to do. Most interrupts end
/// the processor's sleep for nothing.
static WAKE: SharedByte = SharedByte::new(0);

/// Ends the main loop's [`Pace::wait`] for a look around.
#[inline(always)]
pub(crate) fn wake() {
    WAKE.set(1);
}

/// Starts the pulses, with the ESC in neutral, and the ticks.
pub(crate) fn start() {
    masked(|masked| pulses::start(masked, NEUTRAL_AT_START));
    clock::start();
}

/// Takes over what the main loop wants, as it was worked out at `now_us`.
pub(crate) fn publish(now_us: u32, outputs: &Outputs) {
    let servo = outputs.servo_us.map(Width::from_us);
    let esc = Width::from_us(outputs.esc_us);
    let neutral = Width::from_us(outputs.esc_neutral_us);
    let patience = patience(now_us, outputs.drive_deadline_us);
    masked(|masked| {
        SERVO.set(masked, servo);
        ESC.set(masked, esc);
        NEUTRAL.set(masked, neutral);
        PATIENCE.set(patience);
        SILENT_TICKS.set(0);
    });
}

/// How many ticks may follow without another plan: until the command's
/// deadline has passed or the main loop must be taken to hang.
fn patience(now_us: u32, deadline_us: Option<u32>) -> u8 {
    let Some(deadline_us) = deadline_us else {
        return PATIENCE_TICKS;
    };
    let left_us = deadline_us.wrapping_sub(now_us);
    if left_us >= u32::from(PATIENCE_TICKS) * clock::TICK_US {
        // A deadline that has passed is a long way off on a clock that wraps.
        return if left_us > u32::MAX / 2 {
            0
        } else {
            PATIENCE_TICKS
        };
    }
    // 16 bits: a division of 32 takes three times as long.
    (left_us as u16 / clock::TICK_US as u16) as u8
}

/// A steady pace for the main loop, however long a round takes.
pub(crate) struct Pace {
    last: u8,
}

impl Pace {
    pub(crate) const fn new() -> Self {
        Self { last: 0 }
    }

    /// Sleeps until a number of ticks have passed since the last time that this
    /// returned `true`, or until there is something to do `sooner`, about which
    /// it asks after a tick and after a [`wake`]; then it returns `false`. What
    /// was missed is not made up for.
    pub(crate) fn wait(&mut self, ticks: u8, sooner: impl Fn() -> bool) -> bool {
        loop {
            sleep_until_woken();
            let passed = TICKS.get().wrapping_sub(self.last);
            if passed >= ticks {
                self.last = self.last.wrapping_add(passed - passed % ticks);
                return true;
            }
            if sooner() {
                return false;
            }
        }
    }
}

#[inline(always)]
fn sleep_until_woken() {
    loop {
        interrupts::disable();
        if WAKE.get() != 0 {
            break;
        }
        interrupts::enable_and_sleep();
    }
    WAKE.set(0);
    interrupts::enable();
}

/// Timer 0, compare match A: every millisecond.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_14() {
    // SAFETY: this is an interrupt handler.
    let masked = unsafe { Masked::assume() };
    clock::tick(masked);
    TICKS.set(TICKS.get().wrapping_add(1));
    wake();
    let mut silent_ticks = SILENT_TICKS.get();
    if silent_ticks != u8::MAX {
        silent_ticks += 1;
        SILENT_TICKS.set(silent_ticks);
    }
    if pulses::are_due(masked) {
        if silent_ticks > PATIENCE.get() {
            pulses::show_esc(masked, NEUTRAL.get(masked));
        } else {
            pulses::show_esc(masked, ESC.get(masked));
        }
        pulses::show_servo(masked, SERVO.get(masked));
    }
}
