//! Whether somebody sets the clock on the wall.
//!
//! Nothing here depends on it: a record maps its times to the wall once, at its
//! beginning. Who compares the record with others wants to know.

use core::fmt;

/// Less than this is nobody's doing: the two clocks are read one after the other.
const SMALLEST_STEP_NS: i64 = 100_000_000;

/// How far the clock on the wall was set forward, in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct WallStep(pub(crate) i64);

impl fmt::Display for WallStep {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "the wall clock was set by {:+.3} s",
            self.0 as f64 * 1e-9
        )
    }
}

/// Compares the clock on the wall with one that nobody sets.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WallWatch {
    /// Wall minus monotonic, as last told.
    known_ns: Option<i64>,
    /// Whether the last look showed another difference.
    suspected: bool,
}

impl WallWatch {
    /// Takes in what both clocks say. Tells of a step when two looks in a row show
    /// it: between the reading of one clock and of the other anything may come.
    pub(crate) fn look(&mut self, monotonic_ns: u64, wall_ns: u64) -> Option<WallStep> {
        let difference_ns = wall_ns.wrapping_sub(monotonic_ns) as i64;
        let step_ns = difference_ns.wrapping_sub(*self.known_ns.get_or_insert(difference_ns));
        let differs = step_ns.unsigned_abs() >= SMALLEST_STEP_NS.unsigned_abs();
        let confirmed = differs && self.suspected;
        self.suspected = differs && !confirmed;
        confirmed.then(|| {
            self.known_ns = Some(difference_ns);
            WallStep(step_ns)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_step_of_an_hour_is_told_once_and_the_way_back_too() {
        let mut watch = WallWatch::default();
        let mut told = Vec::new();
        for look in 0..60_u64 {
            let hour = if (20..40).contains(&look) { 3_600 } else { 0 };
            let monotonic = 1_000 * SECOND_NS + look * SECOND_NS / 50;
            let step = watch.look(monotonic, monotonic + (1_000_000 + hour) * SECOND_NS);
            told.extend(step.map(|step| (look, step)));
        }
        let hour = WallStep(3_600 * SECOND_NS as i64);
        assert_eq!(told, [(21, hour), (41, WallStep(-hour.0))]);
        assert_eq!(hour.to_string(), "the wall clock was set by +3600.000 s");
    }

    #[test]
    fn a_pause_between_the_two_readings_is_no_step() {
        let mut watch = WallWatch::default();
        for look in 0..50_u64 {
            let monotonic = look * SECOND_NS;
            let pause = if look % 7 == 3 { SECOND_NS } else { 0 };
            assert_eq!(
                watch.look(monotonic, 5 * SECOND_NS + monotonic + pause),
                None
            );
        }
    }
}
