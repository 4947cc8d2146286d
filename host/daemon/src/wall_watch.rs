//! Detects steps of the wall clock, for the log.
//!
//! The daemon does not depend on the wall clock: a record maps its times to it once, at its
//! start. The log line helps to compare a record with others.

/// The smallest step: the two clocks are read one after the other.
const SMALLEST_STEP_NS: i64 = 100_000_000;

/// Compares the wall clock with the monotonic one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WallWatch {
    /// Wall minus monotonic time, as last reported.
    known_ns: Option<i64>,
    /// Whether the last reading showed another difference.
    suspected: bool,
}

impl WallWatch {
    /// Handles a reading of both clocks. Returns a step, in ns and positive forward, when two
    /// readings in a row show it: the thread may be delayed between the clocks of one reading.
    pub(crate) fn update(&mut self, monotonic_ns: u64, wall_ns: u64) -> Option<i64> {
        let difference_ns = wall_ns.wrapping_sub(monotonic_ns) as i64;
        let step_ns = difference_ns.wrapping_sub(*self.known_ns.get_or_insert(difference_ns));
        let differs = step_ns.unsigned_abs() >= SMALLEST_STEP_NS.unsigned_abs();
        let confirmed = differs && self.suspected;
        self.suspected = differs && !confirmed;
        confirmed.then(|| {
            self.known_ns = Some(difference_ns);
            step_ns
        })
    }
}

/// The line of the log for a step, in ns.
pub(crate) fn describe(step_ns: i64) -> String {
    let step_s = step_ns as f64 * 1e-9;
    format!("the wall clock was set by {step_s:+.3} s; times in the record are not affected")
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_step_of_an_hour_and_back_is_reported_once_each() {
        let mut watch = WallWatch::default();
        let mut reported = Vec::new();
        for reading in 0..60_u64 {
            let hour = if (20..40).contains(&reading) {
                3_600
            } else {
                0
            };
            let monotonic = 1_000 * SECOND_NS + reading * SECOND_NS / 50;
            let step = watch.update(monotonic, monotonic + (1_000_000 + hour) * SECOND_NS);
            reported.extend(step.map(|step| (reading, step)));
        }
        let hour_ns = 3_600 * SECOND_NS as i64;
        assert_eq!(reported, [(21, hour_ns), (41, -hour_ns)]);
        assert!(describe(hour_ns).starts_with("the wall clock was set by +3600.000 s"));
    }

    #[test]
    fn a_pause_within_one_reading_is_no_step() {
        let mut watch = WallWatch::default();
        for reading in 0..50_u64 {
            let monotonic = reading * SECOND_NS;
            let pause = if reading % 7 == 3 { SECOND_NS } else { 0 };
            assert_eq!(
                watch.update(monotonic, 5 * SECOND_NS + monotonic + pause),
                None
            );
        }
    }
}
