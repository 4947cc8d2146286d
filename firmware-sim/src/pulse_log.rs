//! Log of the pulses on the board's pins.

use std::collections::VecDeque;

/// A servo frame: both pulses start at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseRecord {
    /// Simulation time at which the pulses start, in µs.
    pub time_us: u64,
    /// Board time, in µs, wrapping.
    pub board_time_us: u32,
    /// Servo pulse in µs; zero for none.
    pub servo_us: u16,
    /// ESC pulse in µs; zero for none.
    pub esc_us: u16,
    /// A reset cut the pulses, which are therefore shorter than intended.
    pub cut: bool,
}

/// A change of the pulses between the board's pins and the car, to plant a bug.
pub trait PulseFilter {
    /// Changes a servo frame of a native board before car and log get it. The image's
    /// frames are not changed.
    fn frame(&mut self, frame: &mut PulseRecord);

    /// Changes the kill output of a native board.
    fn power(&mut self, on: &mut bool) {
        let _ = on;
    }
}

/// No change.
pub(crate) struct Unfiltered;

impl PulseFilter for Unfiltered {
    fn frame(&mut self, _: &mut PulseRecord) {}
}

/// The most recent servo frames.
#[derive(Clone, Debug, Default)]
pub struct PulseLog {
    records: VecDeque<PulseRecord>,
    total: u64,
}

impl PulseLog {
    /// Number of frames kept: twenty minutes at 50 Hz.
    pub const CAPACITY: usize = 60_000;

    pub(crate) fn push(&mut self, record: PulseRecord) {
        if self.records.len() >= Self::CAPACITY {
            self.records.pop_front();
        }
        self.records.push_back(record);
        self.total += 1;
    }

    /// Number of frames since the start, including those no longer kept.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// The frames, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &PulseRecord> {
        self.records.iter()
    }

    /// The last frame.
    #[must_use]
    pub fn last(&self) -> Option<&PulseRecord> {
        self.records.back()
    }

    /// The first frame at or after `time_us` from which on all ESC pulses are
    /// absent or within `tolerance_us` of neutral. Pulses that a reset cut below
    /// neutral are ignored.
    #[must_use]
    pub fn neutral_from(
        &self,
        time_us: u64,
        neutral_us: u16,
        tolerance_us: u16,
    ) -> Option<PulseRecord> {
        self.records
            .iter()
            .rev()
            .take_while(|record| record.time_us >= time_us)
            .filter(|record| !record.cut || record.esc_us > neutral_us)
            .take_while(|record| {
                record.esc_us == 0 || record.esc_us.abs_diff(neutral_us) <= tolerance_us
            })
            .last()
            .copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neutral_counts_from_the_first_frame_of_the_last_neutral_phase() {
        let mut log = PulseLog::default();
        for (i, esc_us) in [1500, 1560, 1500, 1560, 1502, 1500, 0]
            .into_iter()
            .enumerate()
        {
            log.push(PulseRecord {
                time_us: i as u64 * 20_000,
                board_time_us: 0,
                servo_us: 0,
                esc_us,
                cut: false,
            });
        }
        let at = |time_us| {
            log.neutral_from(time_us, 1500, 5)
                .map(|record| record.time_us)
        };
        assert_eq!(at(0), Some(80_000));
        assert_eq!(at(100_000), Some(100_000));
        assert_eq!(at(120_001), None);
    }
    #[test]
    fn a_pulse_cut_by_a_reset_neither_starts_nor_ends_neutral() {
        let from = |pulses: &[(u16, bool)]| {
            let mut log = PulseLog::default();
            for (i, &(esc_us, cut)) in pulses.iter().enumerate() {
                log.push(PulseRecord {
                    time_us: i as u64,
                    board_time_us: 0,
                    servo_us: 0,
                    esc_us,
                    cut,
                });
            }
            log.neutral_from(0, 1500, 5).map(|record| record.time_us)
        };
        let driven = (1560, false);
        let silent = (0, false);
        assert_eq!(from(&[driven, (1500, false), (900, true), silent]), Some(1));
        assert_eq!(from(&[driven, (900, true), silent]), Some(2));
        assert_eq!(from(&[driven, (900, false), silent]), Some(2));
        assert_eq!(
            from(&[driven, (1500, false), (1540, true), silent]),
            Some(3)
        );
    }
}
