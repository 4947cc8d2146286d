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

/// A main loop that has been silent for so many milliseconds hangs. (With a
/// servo period of 20 ms on top, the neutral pulse is out within 45 ms.)
const PATIENCE_TICKS: u8 = 20;

/// What every ESC takes for neutral: shown until the board says something.
const NEUTRAL_AT_START: Width = Width::from_us(1_500);

/// What the main loop wants.
#[derive(Clone, Copy)]
struct Plan {
    servo: Option<Width>,
    esc: Width,
    neutral: Width,
    /// Last moment at which `esc` may be shown, if `expires`.
    deadline_us: u32,
    expires: bool,
}

static PLAN: Shared<Plan> = Shared::new(Plan {
    servo: None,
    esc: NEUTRAL_AT_START,
    neutral: NEUTRAL_AT_START,
    deadline_us: 0,
    expires: false,
});

/// Ticks since the main loop last said what it wants; stops at 255.
static SILENT_TICKS: SharedByte = SharedByte::new(0);

/// Starts the pulses, with the ESC in neutral, and the ticks.
pub(crate) fn start() {
    masked(|masked| pulses::start(masked, NEUTRAL_AT_START));
    clock::start();
}

/// Takes over what the main loop wants.
pub(crate) fn publish(outputs: &Outputs) {
    let plan = Plan {
        servo: outputs.servo_us.map(Width::from_us),
        esc: Width::from_us(outputs.esc_us),
        neutral: Width::from_us(outputs.esc_neutral_us),
        deadline_us: outputs.drive_deadline_us.unwrap_or(0),
        expires: outputs.drive_deadline_us.is_some(),
    };
    masked(|masked| PLAN.set(masked, plan));
    SILENT_TICKS.set(0);
}

/// Sleeps until there has been a tick since the last [`publish`].
pub(crate) fn wait_for_tick() {
    loop {
        interrupts::disable();
        if SILENT_TICKS.get() != 0 {
            break;
        }
        interrupts::enable_and_sleep();
    }
    interrupts::enable();
}

/// Timer 0, compare match A: every millisecond.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_14() {
    // SAFETY: this is an interrupt handler.
    let masked = unsafe { Masked::assume() };
    let now_us = clock::tick(masked);
    let silent_ticks = SILENT_TICKS.get().saturating_add(1);
    SILENT_TICKS.set(silent_ticks);

    if pulses::are_over(masked) {
        let plan = PLAN.get(masked);
        let expired = plan.expires && (plan.deadline_us.wrapping_sub(now_us) as i32) < 0;
        let esc = if expired || silent_ticks >= PATIENCE_TICKS {
            plan.neutral
        } else {
            plan.esc
        };
        pulses::show(masked, plan.servo, esc);
    }
}
