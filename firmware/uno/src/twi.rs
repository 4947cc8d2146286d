//! I²C bus to the IMU (SDA A4, SCL A5): an interrupt-driven master at 400 kHz.
//!
//! One transfer at a time: some bytes are written, then some are read after a
//! repeated start. The main loop starts a transfer and polls for its end. It aborts
//! a transfer that takes too long, and frees the bus in software.
#![allow(unsafe_code)]

use core::arch::asm;

use crate::{
    interrupts::SharedByte,
    registers::{DDRC, PORTC, TWBR, TWCR, TWDR, TWSR},
};

/// Maximum number of bytes written, and read, in one transfer.
pub(crate) const MAX_WRITE: usize = 3;
pub(crate) const MAX_READ: usize = 26;

/// 16 MHz / (16 + 2 * 12) = 400 kHz.
const DIVISOR: u8 = 12;

// TWCR
const TWINT: u8 = 1 << 7;
const TWEA: u8 = 1 << 6;
const TWSTA: u8 = 1 << 5;
const TWSTO: u8 = 1 << 4;
const TWEN: u8 = 1 << 2;
const TWIE: u8 = 1 << 0;
const GO: u8 = TWINT | TWEN | TWIE;

/// Status codes of the bus (TWSR) after an operation.
mod status {
    pub(super) const MASK: u8 = 0xF8;
    pub(super) const STARTED: u8 = 0x08;
    pub(super) const RESTARTED: u8 = 0x10;
    pub(super) const WRITE_ADDRESS_ACKNOWLEDGED: u8 = 0x18;
    pub(super) const BYTE_ACKNOWLEDGED: u8 = 0x28;
    pub(super) const READ_ADDRESS_ACKNOWLEDGED: u8 = 0x40;
    pub(super) const BYTE_READ: u8 = 0x50;
    pub(super) const LAST_BYTE_READ: u8 = 0x58;
}

// Port C
const SDA: u8 = 1 << 4;
const SCL: u8 = 1 << 5;

/// The current operation of the bus; the interrupt follows its end.
mod phase {
    pub(super) const DONE: u8 = 0;
    pub(super) const FAILED: u8 = 1;
    pub(super) const START: u8 = 2;
    pub(super) const WRITE: u8 = 3;
    pub(super) const RESTART: u8 = 4;
    pub(super) const READ_ADDRESS: u8 = 5;
    pub(super) const READ: u8 = 6;
}

static PHASE: SharedByte = SharedByte::new(phase::DONE);
/// Address in the upper seven bits.
static ADDRESS: SharedByte = SharedByte::new(0);
static TO_WRITE: [SharedByte; MAX_WRITE] = [const { SharedByte::new(0) }; MAX_WRITE];
static TO_WRITE_LENGTH: SharedByte = SharedByte::new(0);
static READ: [SharedByte; MAX_READ] = [const { SharedByte::new(0) }; MAX_READ];
/// Bytes still to be read.
static LEFT: SharedByte = SharedByte::new(0);
/// Bytes written or read so far.
static POSITION: SharedByte = SharedByte::new(0);

/// State of the transfer.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    Busy,
    Done,
    /// No acknowledgement, or a bus error.
    Failed,
}

pub(crate) fn start() {
    // The processor's weak pull-ups, besides the sensor's own: without a sensor the
    // lines must not float.
    PORTC.set(SDA | SCL);
    TWBR.write(DIVISOR);
    TWSR.write(0);
    TWCR.write(TWEN);
}

/// Starts a transfer; none may be in progress.
pub(crate) fn begin(address: u8, write: &[u8], read_length: u8) {
    ADDRESS.set(address << 1);
    for (slot, &byte) in TO_WRITE.iter().zip(write) {
        slot.set(byte);
    }
    TO_WRITE_LENGTH.set(write.len().min(MAX_WRITE) as u8);
    LEFT.set(read_length.min(MAX_READ as u8));
    POSITION.set(0);
    PHASE.set(phase::START);
    TWCR.write(GO | TWSTA);
}

pub(crate) fn progress() -> Progress {
    match PHASE.get() {
        phase::DONE => Progress::Done,
        phase::FAILED => Progress::Failed,
        _ => Progress::Busy,
    }
}

/// Copies the read bytes; returns whether the buffer has changed.
pub(crate) fn take(buffer: &mut [u8]) -> bool {
    let mut changed = false;
    for (known, byte) in buffer.iter_mut().zip(&READ) {
        let byte = byte.get();
        changed |= *known != byte;
        *known = byte;
    }
    changed
}

/// The first byte that was read.
pub(crate) fn first_byte() -> u8 {
    byte::<0>()
}

/// A byte that was read.
pub(crate) fn byte<const INDEX: usize>() -> u8 {
    const { assert!(INDEX < MAX_READ) }
    READ[INDEX].get()
}

/// Aborts the transfer, and frees a bus held by a sensor that has lost count of
/// bits: nine clock pulses let it finish its byte. Takes 0.1 ms.
pub(crate) fn free() {
    TWCR.write(0);
    PHASE.set(phase::FAILED);
    for _ in 0..9 {
        pull_down(SCL);
        half_period();
        release(SCL);
        half_period();
    }
    // Stop: data rises while the clock is high.
    pull_down(SCL);
    half_period();
    pull_down(SDA);
    half_period();
    release(SCL);
    half_period();
    release(SDA);
    half_period();
    TWCR.write(TWEN);
}

/// Open drain: driven low, or released to the pull-ups; never driven high.
fn pull_down(line: u8) {
    PORTC.clear(line);
    DDRC.set(line);
}

fn release(line: u8) {
    DDRC.clear(line);
    PORTC.set(line);
}

/// 5 µs or a little more: slow enough for any sensor.
fn half_period() {
    // SAFETY: counts down a register.
    unsafe {
        asm!("1: dec {0}", "brne 1b", inout(reg_upper) 27_u8 => _, options(nomem, nostack));
    }
}

/// End of a bus operation.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_24() {
    let status = TWSR.read() & status::MASK;
    // Fast path for nearly all interrupts: a jump table or a chain of comparisons
    // would take a fifth more time.
    if status == status::BYTE_READ && PHASE.get() == phase::READ {
        store();
        let left = LEFT.get() - 1;
        LEFT.set(left);
        TWCR.write(if left > 1 { GO | TWEA } else { GO });
        return;
    }
    match PHASE.get() {
        phase::READ if status == status::LAST_BYTE_READ => {
            store();
            finish(phase::DONE);
        }
        phase::START if status == status::STARTED => {
            TWDR.write(ADDRESS.get());
            PHASE.set(phase::WRITE);
            TWCR.write(GO);
        }
        phase::WRITE
            if status == status::WRITE_ADDRESS_ACKNOWLEDGED
                || status == status::BYTE_ACKNOWLEDGED =>
        {
            let position = POSITION.get();
            if position != TO_WRITE_LENGTH.get() {
                POSITION.set(position.wrapping_add(1));
                if let Some(byte) = TO_WRITE.get(usize::from(position)) {
                    TWDR.write(byte.get());
                }
                TWCR.write(GO);
            } else if LEFT.get() != 0 {
                PHASE.set(phase::RESTART);
                TWCR.write(GO | TWSTA);
            } else {
                finish(phase::DONE);
            }
        }
        phase::RESTART if status == status::RESTARTED => {
            const READING: u8 = 1;
            TWDR.write(ADDRESS.get() | READING);
            POSITION.set(0);
            PHASE.set(phase::READ_ADDRESS);
            TWCR.write(GO);
        }
        phase::READ_ADDRESS if status == status::READ_ADDRESS_ACKNOWLEDGED => {
            PHASE.set(phase::READ);
            // The last byte is not acknowledged.
            TWCR.write(if LEFT.get() > 1 { GO | TWEA } else { GO });
        }
        _ => finish(phase::FAILED),
    }
}

/// Stores the byte that was read.
#[inline(always)]
fn store() {
    let position = POSITION.get();
    POSITION.set(position.wrapping_add(1));
    if let Some(slot) = READ.get(usize::from(position)) {
        slot.set(TWDR.read());
    }
}

#[inline(always)]
fn finish(phase: u8) {
    TWCR.write(TWINT | TWEN | TWSTO);
    PHASE.set(phase);
}
