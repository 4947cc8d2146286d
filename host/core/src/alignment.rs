//! When to tick, so that a fresh pose is there.
//!
//! Cameras and controller both run at 100 Hz, each by its own clock. If frames
//! arrive just when ticks begin, some ticks get none and the next gets two: a
//! pose is a whole period old for no reason. So the grid of the ticks slides,
//! slowly, until they begin a little after the frames arrive.

/// How long before a tick a frame should have arrived: more than it jitters.
const MARGIN_NS: u64 = 2_000_000;

/// While nothing is at stake the grid may slide by a part of the period.
const FAST: u64 = 20;

/// While the car drives it slides by a part so small that the control period
/// stays what it is, and large enough for clocks that differ by 0.2 %.
const SLOW: u64 = 500;

/// Keeps ticks behind the arrival of frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alignment {
    period_ns: u64,
    arrival_ns: Option<u64>,
}

impl Alignment {
    pub(crate) const fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            arrival_ns: None,
        }
    }

    /// A frame arrived.
    pub(crate) const fn arrived(&mut self, time_ns: u64) {
        self.arrival_ns = Some(time_ns);
    }

    /// How much later the next tick should begin than a period after this one,
    /// which began at `start_ns`; negative for earlier.
    ///
    /// One step towards the aim, whatever the distance: a single late frame
    /// moves nothing far.
    pub(crate) fn slide_ns(&mut self, start_ns: u64, is_driving: bool) -> i64 {
        let Some(arrival_ns) = self.arrival_ns.take() else {
            return 0;
        };
        let age_ns = start_ns.saturating_sub(arrival_ns) % self.period_ns;
        let step_ns = self.period_ns / if is_driving { SLOW } else { FAST };
        // Later, if the frame was hardly there, or if that is the shorter way
        // to the next frame.
        let late_ns = (age_ns + self.period_ns - MARGIN_NS % self.period_ns) % self.period_ns;
        let (distance_ns, sign) = if late_ns > self.period_ns / 2 {
            (self.period_ns - late_ns, 1)
        } else {
            (late_ns, -1)
        };
        sign * i64::try_from(distance_ns.min(step_ns)).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 10_000_000;

    /// Ages of the newest frame at the ticks of a run, in ns.
    fn ages(frame_period: u64, phase: u64, driving: bool, ticks: usize) -> Vec<u64> {
        let mut alignment = Alignment::new(PERIOD);
        let mut frame = phase;
        let mut tick = 10 * PERIOD;
        (0..ticks)
            .map(|_| {
                while frame + frame_period <= tick {
                    frame += frame_period;
                }
                let age = tick - frame;
                alignment.arrived(frame);
                let slide = alignment.slide_ns(tick, driving);
                tick = tick.saturating_add_signed(PERIOD as i64 + slide);
                age
            })
            .collect()
    }

    #[test]
    fn from_any_phase_ticks_come_to_follow_frames_by_the_margin() {
        for phase in (0..PERIOD).step_by(250_000) {
            for age in &ages(PERIOD, phase, false, 60)[30..] {
                assert!(age.abs_diff(MARGIN_NS) <= PERIOD / FAST, "{phase}: {age}");
            }
        }
    }

    #[test]
    fn a_camera_clock_that_differs_is_followed_while_driving() {
        for frame_period in [PERIOD - 10_000, PERIOD + 10_000] {
            let ages = ages(frame_period, 8_000_000, true, 20_000);
            for age in &ages[1_000..] {
                assert!(age.abs_diff(MARGIN_NS) < 100_000, "{frame_period}: {age}");
            }
        }
    }

    #[test]
    fn the_period_changes_by_a_five_hundredth_at_most_while_driving() {
        let mut alignment = Alignment::new(PERIOD);
        for age in (0..PERIOD).step_by(100_000) {
            alignment.arrived(PERIOD);
            let slide = alignment.slide_ns(PERIOD + age, true);
            assert!(slide.unsigned_abs() <= PERIOD / 500);
        }
    }

    #[test]
    fn without_frames_the_grid_stays() {
        let mut alignment = Alignment::new(PERIOD);
        assert_eq!(alignment.slide_ns(PERIOD, false), 0);
        alignment.arrived(PERIOD);
        assert_ne!(alignment.slide_ns(PERIOD + 5_000_000, false), 0);
        assert_eq!(alignment.slide_ns(2 * PERIOD, false), 0);
    }
}
