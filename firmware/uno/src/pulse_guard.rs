//! The pulse guard: a 1 kHz interrupt with final authority over the pulses.
//!
//! The main loop publishes the pulses and their deadline; only the interrupt writes
//! them to the timer. It sets the ESC to neutral, and drops the kill output, when the
//! deadline has passed, and when the main loop has published nothing for
//! [`TIMEOUT_TICKS`]. A silent ESC stays silent.

#![allow(unsafe_code)]

use singletrack_board::Outputs;

use crate::{
    clock,
    interrupts::{self, Masked, Shared, SharedByte, masked},
    motor,
    pulses::{self, Width},
};

/// Number of ticks after which a silent main loop counts as hung. (With one servo
/// period of 20 ms, the neutral pulse is out within 45 ms.)
const TIMEOUT_TICKS: u8 = 19;

/// Neutral pulse of every ESC, used until the board publishes one.
const NEUTRAL_AT_START: Width = Width::from_us(1_500);

// Published by the main loop. (Separate statics, because the compiler would
// disassemble one structure with 64-bit shifts.)
static SERVO: Shared<Option<Width>> = Shared::new(None);
static ESC: Shared<Option<Width>> = Shared::new(Some(NEUTRAL_AT_START));
static NEUTRAL: Shared<Width> = Shared::new(NEUTRAL_AT_START);
static POWER_ON: SharedByte = SharedByte::new(0);
/// Ticks for which `ESC` is valid without another publication.
static VALID_TICKS: SharedByte = SharedByte::new(0);

/// Ticks since the last publication; saturates at 255.
static SILENT_TICKS: SharedByte = SharedByte::new(0);

/// Ticks so far, wrapping; the time base of the main loop.
static TICKS: SharedByte = SharedByte::new(0);

/// Not zero: the guard has set pulses since the last [`guarded`].
static SET_PULSES: SharedByte = SharedByte::new(0);

/// Not zero: the main loop must wake. Most interrupts end the processor's sleep
/// without work for it.
static WAKE: SharedByte = SharedByte::new(0);

/// Wakes the main loop in [`Pace::wait`].
#[inline(always)]
pub(crate) fn wake() {
    WAKE.set(1);
}

/// Starts the pulses, with the ESC in neutral, and the ticks.
pub(crate) fn start() {
    masked(|masked| {
        pulses::start_supply(masked);
        pulses::start(masked, NEUTRAL_AT_START);
    });
    clock::start();
}

/// Publishes the outputs that the main loop computed at `now_us`.
pub(crate) fn publish(now_us: u32, outputs: &Outputs) {
    let servo = outputs.servo_us.map(Width::from_us);
    let esc = outputs.esc_us.map(Width::from_us);
    let neutral = Width::from_us(outputs.esc_neutral_us);
    let valid_ticks = valid_ticks(now_us, outputs.drive_deadline_us);
    masked(|masked| {
        SERVO.set(masked, servo);
        ESC.set(masked, esc);
        NEUTRAL.set(masked, neutral);
        POWER_ON.set(u8::from(outputs.power_on));
        VALID_TICKS.set(valid_ticks);
        SILENT_TICKS.set(0);
    });
}

/// Proof that the guard has set the pulses of a servo period: its interrupt runs, and the
/// timer of the pulses too.
pub(crate) struct Guarded(());

/// The proof, once for each servo period.
pub(crate) fn guarded() -> Option<Guarded> {
    if SET_PULSES.get() == 0 {
        return None;
    }
    SET_PULSES.set(0);
    Some(Guarded(()))
}

/// Number of ticks until the command's deadline has passed or the main loop counts
/// as hung.
fn valid_ticks(now_us: u32, deadline_us: Option<u32>) -> u8 {
    let Some(deadline_us) = deadline_us else {
        return TIMEOUT_TICKS;
    };
    let left_us = deadline_us.wrapping_sub(now_us);
    if left_us >= u32::from(TIMEOUT_TICKS) * clock::TICK_US {
        // A deadline in the past appears far in the future on a wrapping clock.
        return if left_us > u32::MAX / 2 {
            0
        } else {
            TIMEOUT_TICKS
        };
    }
    // 16 bits: a division of 32 bits takes three times as long.
    (left_us as u16 / clock::TICK_US as u16) as u8
}

/// A steady period for the main loop, independent of the time of a round.
pub(crate) struct Pace {
    last: u8,
}

impl Pace {
    pub(crate) const fn new() -> Self {
        Self { last: 0 }
    }

    /// Sleeps until `ticks` ticks have passed since it last returned `true`, and
    /// returns `true`; or until `sooner`, which is called after a tick and after a
    /// [`wake`], is true, and returns `false`. Missed periods are not made up for.
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
    motor::tick(masked);
    let is_valid = silent_ticks <= VALID_TICKS.get();
    pulses::set_supply(masked, is_valid && POWER_ON.get() != 0);
    if pulses::are_due(masked) {
        let esc = ESC.get(masked);
        let esc = if is_valid {
            esc
        } else {
            esc.map(|_| NEUTRAL.get(masked))
        };
        pulses::set(masked, SERVO.get(masked), esc);
        SET_PULSES.set(1);
    }
}
