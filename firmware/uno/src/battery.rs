//! Battery voltage (A0), behind a divider by two, and the processor's supply.
//!
//! The converter's reference is the supply, which USB lets vary by 10 %. It is
//! measured against the processor's own reference (the bandgap, 1.1 V), which does
//! not. A third measurement, with the pin's pull-up on, tells whether anything is
//! connected: the divider's 5 kOhm hardly move, an open pin goes to the supply.

use crate::registers::{ADCH, ADCL, ADCSRA, ADMUX, DIDR0, PORTC};

/// Rounds between two sets of measurements: 100 ms.
const PERIOD: u8 = 20;

/// `AVcc` is the reference.
const REFS0: u8 = 1 << 6;
const ADC0: u8 = 0;
const BANDGAP: u8 = 0b1110;
const DIGITAL_0: u8 = 1 << 0;
const ADEN: u8 = 1 << 7;
const ADSC: u8 = 1 << 6;
/// Prescaler 128: 125 kHz, 104 µs for a conversion.
const ADPS: u8 = 0b111;

/// Port C, bit 0.
const PULL_UP: u8 = 1 << 0;

/// The bandgap's voltage, in mV. (1.0 to 1.2 V by the data sheet, constant for a
/// chip.)
const BANDGAP_MV: u32 = 1_100;

/// With the pull-up on, an input above this floats: 98.6 % of the supply. A battery
/// of 8.4 V reaches 97 % with the lowest supply.
const OPEN: u16 = 1_010;

/// Periodic measurement of battery and supply.
pub(crate) struct Battery {
    rounds: u8,
    battery: u16,
    bandgap: u16,
    pub(crate) millivolts: u16,
    pub(crate) supply_mv: u16,
    pub(crate) open: bool,
}

pub(crate) fn start() {
    DIDR0.write(DIGITAL_0);
    ADMUX.write(REFS0 | ADC0);
    ADCSRA.write(ADEN | ADPS);
}

impl Battery {
    pub(crate) const fn new() -> Self {
        Self {
            rounds: 0,
            battery: 0,
            bandgap: 0,
            millivolts: 0,
            supply_mv: 0,
            open: false,
        }
    }

    /// Call in every round. A channel settles for a round before its conversion.
    pub(crate) fn poll(&mut self) {
        match self.rounds {
            0 | 2 | 4 => convert(),
            1 => {
                self.battery = reading();
                ADMUX.write(REFS0 | BANDGAP);
            }
            3 => {
                self.bandgap = reading();
                PORTC.set(PULL_UP);
                ADMUX.write(REFS0 | ADC0);
            }
            5 => {
                self.open = reading() >= OPEN;
                PORTC.clear(PULL_UP);
                self.compute();
            }
            _ => {}
        }
        self.rounds += 1;
        if self.rounds == PERIOD {
            self.rounds = 0;
        }
    }

    #[inline(never)]
    fn compute(&mut self) {
        let supply_mv = (BANDGAP_MV * 1_024)
            .checked_div(self.bandgap.into())
            .unwrap_or(0);
        self.supply_mv = u16::try_from(supply_mv).unwrap_or(u16::MAX);
        // A reading of 1024 is the supply at the pin and twice that at the battery.
        let millivolts = (u32::from(self.battery) * u32::from(self.supply_mv)) >> 9;
        self.millivolts = u16::try_from(millivolts).unwrap_or(u16::MAX);
    }
}

fn convert() {
    ADCSRA.write(ADEN | ADSC | ADPS);
}

/// The conversion started a round ago, so it is complete.
fn reading() -> u16 {
    // Reading the low byte latches the high one.
    let low = ADCL.read();
    u16::from_le_bytes([low, ADCH.read()])
}
