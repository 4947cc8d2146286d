//! The pulses that servo and ESC get, from what the telemetry says of them.
//!
//! The board begins a pulse for each of the two every 20 ms since its start, and makes a record
//! every 10 ms: the native board at multiples of 10 ms, the Arduino's image 5 ms after them. A
//! pulse is as long as the last record says that was made until then.

/// Microseconds between two pulses, and between two records.
const FRAME_US: u32 = 20_000;
const RECORD_US: u32 = 10_000;

/// Records are made at multiples of this since the board's start.
const GRID_US: u32 = 5_000;

/// The most by which a record is late that names the pulse which begins with it.
const LATE_US: u32 = 1_000;

/// After the 71 minutes in which the board's clock has counted through, records no longer come
/// at multiples of 5 ms: by that they show how often it has.
const MOST_TURNS: u32 = 3;

/// The pulses of an output.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Frames(
    /// When each began, s, and its length, µs.
    pub(crate) Vec<(f64, f64)>,
);

/// A record: when it was made, s, the same on the board's clock, µs, and the pulse that it names,
/// µs.
pub(super) type Record = (f64, u32, f64);

impl Frames {
    /// The pulses that these records announce.
    pub(super) fn of(records: &[Record]) -> Self {
        let shifted = |turns: u32| turns.wrapping_mul(u32::MAX % FRAME_US + 1) % FRAME_US;
        // Since the last pulse began.
        let since = |board_us: u32, turns: u32| (board_us % FRAME_US + shifted(turns)) % FRAME_US;
        let off = |board_us: u32, turns: u32| {
            let since_us = since(board_us, turns) % GRID_US;
            u64::from(since_us.min(GRID_US - since_us))
        };
        let far = |turns: u32| -> u64 {
            let records = records.iter().map(|(_, board_us, _)| *board_us);
            records.map(|us| off(us, turns)).sum()
        };
        let turns = (0..=MOST_TURNS)
            .min_by_key(|turns| far(*turns))
            .unwrap_or(0);
        // Until the pulse begins that the record names; none if a later record names it.
        let wait_us = |board_us: u32| {
            let since_us = since(board_us, turns);
            if since_us <= LATE_US {
                return Some(-f64::from(since_us));
            }
            let wait_us = FRAME_US - since_us;
            (wait_us < RECORD_US - LATE_US).then(|| f64::from(wait_us))
        };
        Self(
            records
                .iter()
                .filter_map(|(time, board_us, pulse)| {
                    wait_us(*board_us).map(|wait_us| (time + 1e-6 * wait_us, *pulse))
                })
                .collect(),
        )
    }

    /// The pulse that acts at a time: the last one that has begun, or the first one.
    pub(crate) fn at(&self, time: f64) -> f64 {
        self.last(time).map_or(0.0, |(_, pulse)| pulse)
    }

    /// The mean over a time, which ends at `end` and is shorter than the time between two pulses.
    pub(crate) fn mean(&self, end: f64, lasts: f64) -> f64 {
        let Some((begin, pulse)) = self.last(end) else {
            return 0.0;
        };
        let share = ((end - begin) / lasts).clamp(0.0, 1.0);
        if share == 1.0 {
            return pulse;
        }
        share * pulse + (1.0 - share) * self.at(end - lasts)
    }

    fn last(&self, time: f64) -> Option<(f64, f64)> {
        let after = self.0.partition_point(|(begin, _)| *begin <= time);
        self.0.get(after.saturating_sub(1)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Records of a pulse that grows by 1 us with every record, `turns` after the board's start,
    /// made `after_us` after multiples of 10 ms.
    fn records(turns: u32, after_us: u64) -> Vec<Record> {
        (0..50_u32)
            .map(|n| {
                let since_start_us = (u64::from(turns) << 32) / 20_000 * 20_000 + 40_000;
                let late_us = after_us + 100 * u64::from(n % 3);
                let board_us = (since_start_us + 10_000 * u64::from(n) + late_us) as u32;
                let time = 1e-2 * f64::from(n) + 1e-6 * late_us as f64;
                (time, board_us, f64::from(n))
            })
            .collect()
    }

    #[test]
    fn a_pulse_is_that_of_the_last_record_before_it() {
        for turns in 0..=MOST_TURNS {
            let native = Frames::of(&records(turns, 0));
            for (time, pulse) in [(0.001, 0.0), (0.019, 0.0), (0.0205, 2.0), (0.117, 10.0)] {
                assert_eq!(native.at(time), pulse, "{turns}: {time}");
            }
            let image = Frames::of(&records(turns, 5_000));
            for (time, pulse) in [(0.021, 1.0), (0.039, 1.0), (0.0405, 3.0), (0.117, 9.0)] {
                assert_eq!(image.at(time), pulse, "{turns}: {time}");
            }
        }
        assert_eq!(Frames::default().at(1.0), 0.0);
        let frames = Frames(vec![(0.0, 10.0), (0.02, 20.0)]);
        for (end, mean) in [(0.019, 10.0), (0.021, 15.0), (0.022, 20.0), (-1.0, 10.0)] {
            assert!((frames.mean(end, 0.002) - mean).abs() < 1e-9, "{end}");
        }
    }
}
