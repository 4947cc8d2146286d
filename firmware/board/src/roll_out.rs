//! The watch over a car that is not driven: its wheels must come to rest.
//!
//! An ESC whose neutral is another than the configured one drives the car at
//! neutral, armed or not; one that is stuck goes on driving. Four signs:
//!
//! - The wheels turn for too long, over [`LEAST_MM`] at least: after a drive for longer
//!   than the longest roll-out; from standstill, where a hand pushes the car at most,
//!   for longer than [`PUSHED_MS`]. Few pulses are interference.
//! - From standstill, they turn for farther than [`PUSHED_MM`].
//! - From standstill, they creep: [`LEAST_MM`] in [`CREEP_US`] or longer, without a pause.
//!   Between two pulses that are far apart such wheels seem to stand. A hand is faster, or
//!   pauses.
//! - After a drive, they do not slow down. The speed must stay below a line that
//!   falls to zero within the longest roll-out, for which the slowest car that the
//!   host expects is fast enough.

use crate::{clock::Stopwatch, odometer::Odometer};

/// Shortest way for the first sign.
const LEAST_MM: u32 = 500;

/// Time and way for which a hand may push the car without a pause.
const PUSHED_MS: u16 = 3_000;
const PUSHED_MM: u32 = 1_000;

/// Least time for [`LEAST_MM`] of wheels that creep: 100 mm/s.
const CREEP_US: u32 = 5_000_000;

/// Time after the end of the drive in which the car may still speed up: a servo
/// frame, and the lag of ESC and motor.
const SETTLE_US: u32 = 300_000;

/// Control periods (of 10 ms) above the line for the third sign.
const ABOVE_LINE: u8 = 20;

/// Margin of the line, besides an eighth.
const MARGIN_MM_S: u32 = 50;

/// Pulse distance assumed before the configuration, in µm.
const UNKNOWN_DISTANCE_UM: u16 = 10_000;

#[derive(Clone, Debug)]
pub(crate) struct RollOut {
    longest_ms: u16,
    /// Zero before the configuration.
    pulse_distance_um: u16,
    /// Time for which the wheels have turned without being driven.
    rolling: Stopwatch,
    /// Pulses, wrapping, when that began.
    since_count: u16,
    /// Time since the wheels began to creep, and the pulses then. Both begin again after each
    /// [`LEAST_MM`].
    creeping: Stopwatch,
    creeping_since_count: u16,
    creeps: bool,
    /// The wheels have not come to rest since a drive.
    after_drive: bool,
    fastest_mm_s: u16,
    above_line: u8,
}

impl RollOut {
    pub(crate) const fn new(longest_ms: u16) -> Self {
        Self {
            longest_ms,
            pulse_distance_um: 0,
            rolling: Stopwatch::started(),
            since_count: 0,
            creeping: Stopwatch::started(),
            creeping_since_count: 0,
            creeps: false,
            after_drive: false,
            fastest_mm_s: 0,
            above_line: 0,
        }
    }

    pub(crate) const fn configure(&mut self, longest_ms: u16, pulse_distance_um: u16) {
        self.longest_ms = longest_ms;
        self.pulse_distance_um = pulse_distance_um;
    }

    /// Call in every poll. `driven` says whether the ESC is driven or commanded to
    /// move.
    pub(crate) fn observe(&mut self, elapsed_us: u32, driven: bool, odometer: &Odometer) {
        if driven {
            self.after_drive = true;
        } else if odometer.is_at_rest() {
            self.after_drive = false;
        }
        if driven || !odometer.is_moving() {
            self.rolling = Stopwatch::started();
            self.since_count = odometer.count();
            self.fastest_mm_s = 0;
            self.above_line = 0;
        } else {
            self.rolling.advance(elapsed_us);
        }
        self.creeping.advance(elapsed_us);
        let way_um = self.way_um(odometer.count(), self.creeping_since_count);
        let far = way_um >= LEAST_MM * 1_000;
        if self.after_drive || far || !odometer.is_creeping() {
            self.creeps = far && self.creeping.elapsed_us() >= CREEP_US;
            self.creeping = Stopwatch::started();
            self.creeping_since_count = odometer.count();
        }
    }

    /// Way from a number of pulses to another, in µm: a product of 16 bits each.
    fn way_um(&self, count: u16, since_count: u16) -> u32 {
        let distance_um = if self.pulse_distance_um == 0 {
            UNKNOWN_DISTANCE_UM
        } else {
            self.pulse_distance_um
        };
        u32::from(count.wrapping_sub(since_count)) * u32::from(distance_um)
    }

    /// Call in every poll: whether the wheels have turned for too long or too far.
    pub(crate) fn lasts_too_long(&self, count: u16) -> bool {
        let longest_ms = if self.after_drive {
            self.longest_ms
        } else {
            self.longest_ms.min(PUSHED_MS)
        };
        let way_um = self.way_um(count, self.since_count);
        let too_long = self.rolling.elapsed_us() >= u32::from(longest_ms) * 1_000;
        let is_known = self.pulse_distance_um != 0;
        let too_far = is_known && !self.after_drive && way_um >= PUSHED_MM * 1_000;
        too_far || self.creeps || (too_long && way_um >= LEAST_MM * 1_000)
    }

    /// Call once per control period.
    pub(crate) fn measured(&mut self, speed_mm_s: u16) {
        let rolling_us = self.rolling.elapsed_us();
        if !self.after_drive || rolling_us == 0 {
            return;
        }
        // Pulses that are far apart give no speed until the second one.
        if rolling_us < SETTLE_US || self.fastest_mm_s == 0 {
            self.fastest_mm_s = self.fastest_mm_s.max(speed_mm_s);
            return;
        }
        let fastest = u32::from(self.fastest_mm_s);
        // Below 2^15 both; see `lasts_too_long` for what comes after the roll-out.
        let rolling_ms = (rolling_us >> 10).min(self.longest_ms.into());
        let fallen = fastest * rolling_ms / u32::from(self.longest_ms);
        let line = fastest + fastest / 8 + MARGIN_MM_S - fallen;
        self.above_line = if u32::from(speed_mm_s) > line {
            self.above_line.saturating_add(1)
        } else {
            0
        };
    }

    /// Whether the wheels do not slow down after a drive.
    pub(crate) const fn keeps_its_speed(&self) -> bool {
        self.above_line >= ABOVE_LINE
    }
}

#[cfg(test)]
mod tests {
    use super::{ABOVE_LINE, RollOut, SETTLE_US};
    use crate::clock::Stopwatch;

    fn after_drive() -> RollOut {
        RollOut {
            after_drive: true,
            ..RollOut::new(4_000)
        }
    }

    #[test]
    fn a_speed_above_the_line_for_200_ms_does_not_fall() {
        let mut roll_out = after_drive();
        roll_out.rolling = Stopwatch::started_ago(SETTLE_US - 1);
        roll_out.measured(800);
        // Too late to count as speeding up.
        roll_out.rolling = Stopwatch::started_ago(SETTLE_US);
        roll_out.measured(810);
        // A quarter of the roll-out: 800, an eighth and 50 more, and a quarter less.
        roll_out.rolling = Stopwatch::started_ago(1_000 << 10);
        for _ in 0..ABOVE_LINE {
            roll_out.measured(750);
            assert!(!roll_out.keeps_its_speed());
        }
        for _ in 1..ABOVE_LINE {
            roll_out.measured(751);
            assert!(!roll_out.keeps_its_speed());
        }
        roll_out.measured(750);
        for _ in 1..ABOVE_LINE {
            roll_out.measured(751);
            assert!(!roll_out.keeps_its_speed());
        }
        roll_out.measured(751);
        assert!(roll_out.keeps_its_speed());
    }

    #[test]
    fn the_first_speed_may_come_late() {
        let mut roll_out = after_drive();
        roll_out.rolling = Stopwatch::started_ago(2 * SETTLE_US);
        roll_out.measured(0);
        for _ in 0..2 * ABOVE_LINE {
            roll_out.measured(100);
        }
        assert!(!roll_out.keeps_its_speed());
    }
}
