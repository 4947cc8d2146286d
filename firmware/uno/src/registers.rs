//! The used registers of the ATmega328P, at their data addresses.
#![allow(unsafe_code)]

use crate::interrupts::Masked;

/// A register of one byte.
pub(crate) struct Register(usize);

impl Register {
    #[inline(always)]
    pub(crate) fn read(&self) -> u8 {
        // SAFETY: the address is that of a register, see below.
        unsafe { (self.0 as *const u8).read_volatile() }
    }

    #[inline(always)]
    pub(crate) fn write(&self, value: u8) {
        // SAFETY: the address is that of a register, see below, and none of them
        // makes the processor write to memory.
        unsafe { (self.0 as *mut u8).write_volatile(value) };
    }

    /// Sets bits and keeps the others. An interrupt that writes the same register
    /// must not come between read and write.
    #[inline(always)]
    pub(crate) fn set(&self, bits: u8) {
        self.write(self.read() | bits);
    }

    /// Clears bits and keeps the others. An interrupt that writes the same register
    /// must not come between read and write.
    #[inline(always)]
    pub(crate) fn clear(&self, bits: u8) {
        self.write(self.read() & !bits);
    }

    #[inline(always)]
    pub(crate) fn has(&self, bit: u8) -> bool {
        self.read() & bit != 0
    }
}

/// A register of two bytes of a 16-bit timer.
///
/// The high byte passes through a latch shared by all of them: two accesses must
/// not interleave.
pub(crate) struct WideRegister(usize);

impl WideRegister {
    #[inline(always)]
    pub(crate) fn read_high(&self, _: Masked) -> u8 {
        // Reading the low byte latches the high one.
        Register(self.0).read();
        Register(self.0 + 1).read()
    }

    #[inline(always)]
    pub(crate) fn write(&self, _: Masked, value: u16) {
        // Writing the low byte also writes the high one from the latch.
        let [low, high] = value.to_le_bytes();
        Register(self.0 + 1).write(high);
        Register(self.0).write(low);
    }
}

// Ports
pub(crate) const DDRB: Register = Register(0x24);
pub(crate) const PORTB: Register = Register(0x25);
pub(crate) const DDRC: Register = Register(0x27);
pub(crate) const PORTC: Register = Register(0x28);
pub(crate) const PIND: Register = Register(0x29);
pub(crate) const DDRD: Register = Register(0x2A);
pub(crate) const PORTD: Register = Register(0x2B);

// External interrupts
pub(crate) const EIFR: Register = Register(0x3C);
pub(crate) const EIMSK: Register = Register(0x3D);
pub(crate) const EICRA: Register = Register(0x69);

// Timer 0
pub(crate) const TIFR0: Register = Register(0x35);
pub(crate) const TCCR0A: Register = Register(0x44);
pub(crate) const TCCR0B: Register = Register(0x45);
pub(crate) const TCNT0: Register = Register(0x46);
pub(crate) const OCR0A: Register = Register(0x47);
pub(crate) const TIMSK0: Register = Register(0x6E);

// Timer 1
pub(crate) const TCCR1A: Register = Register(0x80);
pub(crate) const TCCR1B: Register = Register(0x81);
pub(crate) const TCNT1: WideRegister = WideRegister(0x84);
pub(crate) const ICR1: WideRegister = WideRegister(0x86);
pub(crate) const OCR1A: WideRegister = WideRegister(0x88);
pub(crate) const OCR1B: WideRegister = WideRegister(0x8A);

// The processor
pub(crate) const GPIOR1: Register = Register(0x4A);
pub(crate) const SMCR: Register = Register(0x53);
pub(crate) const ACSR: Register = Register(0x50);

// Analogue-to-digital converter
pub(crate) const ADCL: Register = Register(0x78);
pub(crate) const ADCH: Register = Register(0x79);
pub(crate) const ADCSRA: Register = Register(0x7A);
pub(crate) const ADMUX: Register = Register(0x7C);
pub(crate) const DIDR0: Register = Register(0x7E);

// Two-wire interface
pub(crate) const TWBR: Register = Register(0xB8);
pub(crate) const TWSR: Register = Register(0xB9);
pub(crate) const TWDR: Register = Register(0xBB);
pub(crate) const TWCR: Register = Register(0xBC);

// Serial line
pub(crate) const UCSR0A: Register = Register(0xC0);
pub(crate) const UCSR0B: Register = Register(0xC1);
pub(crate) const UCSR0C: Register = Register(0xC2);
pub(crate) const UBRR0L: Register = Register(0xC4);
pub(crate) const UBRR0H: Register = Register(0xC5);
pub(crate) const UDR0: Register = Register(0xC6);
