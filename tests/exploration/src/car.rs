//! The car: its wheels turn while the ESC drives, and roll out.

use singletrack_board::MotorPulses;

/// Speed while the ESC drives, and distance of the motor's pulses: one in each tick.
pub(crate) const DRIVEN_M_S: f64 = 0.3;

/// Ticks of the roll-out in which a pulse comes: at about 1 m/s².
const ROLL_OUT: [u8; 6] = [1, 2, 4, 6, 9, 14];

/// Ticks after which the car stands.
const STANDS_AFTER: u8 = 24;

/// Wheels and motor sensor.
#[derive(Clone, Debug)]
pub(crate) struct Car {
    /// Ticks since the ESC drove; [`STANDS_AFTER`] for a car that stands.
    rolled: u8,
    pub(crate) pulses: MotorPulses,
}

impl Car {
    pub(crate) const fn new() -> Self {
        Self {
            rolled: STANDS_AFTER,
            pulses: MotorPulses {
                count: 0,
                last_edge_us: 0,
            },
        }
    }

    /// The board has started again, with a clock of its own.
    pub(crate) const fn board_restarted(&mut self) {
        self.pulses = MotorPulses {
            count: 0,
            last_edge_us: 0,
        };
    }

    pub(crate) fn advance(&mut self, drives: bool, board_us: u32) {
        self.rolled = if drives {
            0
        } else {
            (self.rolled + 1).min(STANDS_AFTER)
        };
        if drives || ROLL_OUT.contains(&self.rolled) {
            self.pulses.count = self.pulses.count.wrapping_add(1);
            self.pulses.last_edge_us = board_us;
        }
    }

    pub(crate) fn speed(&self) -> f64 {
        DRIVEN_M_S * f64::from(STANDS_AFTER - self.rolled) / f64::from(STANDS_AFTER)
    }
}
