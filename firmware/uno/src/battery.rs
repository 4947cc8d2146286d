//! Battery voltage (A0), behind a divider by two.

use crate::registers::{ADCH, ADCL, ADCSRA, ADMUX, DIDR0};

/// Rounds between two measurements: 100 ms.
const PERIOD: u8 = 20;

/// `AVcc` is the reference, ADC0 the input.
const REFS0: u8 = 1 << 6;
const ADC0: u8 = 1 << 0;
const ADEN: u8 = 1 << 7;
const ADSC: u8 = 1 << 6;
/// Prescaler 128: 125 kHz, 104 µs for a conversion.
const ADPS: u8 = 0b111;

/// Periodic measurement of the battery voltage.
pub(crate) struct Battery {
    rounds: u8,
    millivolts: u16,
}

pub(crate) fn start() {
    DIDR0.write(ADC0);
    ADMUX.write(REFS0);
    ADCSRA.write(ADEN | ADSC | ADPS);
}

impl Battery {
    pub(crate) const fn new() -> Self {
        Self {
            rounds: 0,
            millivolts: 0,
        }
    }

    /// Call in every round; returns the newest measurement, in mV.
    pub(crate) fn poll(&mut self) -> u16 {
        self.rounds += 1;
        if self.rounds == PERIOD {
            self.rounds = 0;
            // Started one period ago, so it is complete. Reading the low byte
            // latches the high one.
            let low = ADCL.read();
            let reading = u16::from_le_bytes([low, ADCH.read()]);
            self.millivolts = millivolts(reading);
            ADCSRA.write(ADEN | ADSC | ADPS);
        }
        self.millivolts
    }
}

/// A reading of 1024 is 5 V at the pin and 10 V at the battery.
fn millivolts(reading: u16) -> u16 {
    (u32::from(reading) * 10_000 / 1_024) as u16
}
