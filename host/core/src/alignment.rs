//! Alignment of the ticks with the camera frames, so that a tick has a fresh pose.
//!
//! Cameras and controller both run at 100 Hz, each by its own clock. If frames arrive just
//! when ticks begin, some ticks get no frame and the next ones two, and poses are up to a
//! period older than necessary. The grid of the ticks therefore slides slowly until ticks
//! begin a little after frames arrive: three quarters of a millisecond, and longer if frames
//! arrive unevenly.

/// The target time from the arrival of a frame to the tick, ns, if frames arrive evenly.
const LEAST_MARGIN_NS: u64 = 750_000;

/// The target if they do not, at most.
const MOST_MARGIN_NS: u64 = 2_000_000;

/// The part of the spread of the arrivals that is forgotten with each frame: it takes some
/// seconds, so that a network that is late now and then keeps its margin.
const FORGET: u64 = 512;

/// While the car does not drive, a step of the grid is at most the period over this.
const FAST: u64 = 20;

/// While the car drives, a step is at most the period over this: too small to matter for
/// the control period, and large enough to follow clocks that differ by 0.2 %.
const SLOW: u64 = 500;

/// Computes the slides of the grid from the arrivals of frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alignment {
    period_ns: u64,
    /// When the newest frame arrived, if that was since the last tick.
    arrival_ns: Option<u64>,
    last_arrival_ns: Option<u64>,
    /// By how much frames come earlier or later after the one before than whole periods, ns.
    spread_ns: u64,
}

impl Alignment {
    pub(crate) const fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            arrival_ns: None,
            last_arrival_ns: None,
            spread_ns: 0,
        }
    }

    /// A frame arrived.
    pub(crate) fn arrived(&mut self, time_ns: u64) {
        self.arrival_ns = Some(time_ns);
        if let Some(last_ns) = self.last_arrival_ns.replace(time_ns) {
            let beyond_ns = time_ns.saturating_sub(last_ns) % self.period_ns;
            let uneven_ns = beyond_ns.min(self.period_ns - beyond_ns);
            self.spread_ns = (self.spread_ns - self.spread_ns / FORGET).max(uneven_ns);
        }
    }

    /// The target time from the arrival of a frame to the tick, ns: more than the spread.
    fn margin_ns(&self) -> u64 {
        (LEAST_MARGIN_NS + self.spread_ns).min(MOST_MARGIN_NS)
    }

    /// By how much to delay the next tick beyond a period after `start_ns`, the start of
    /// this one, in ns; negative to advance it. 0 if no frame has arrived since the last
    /// call.
    ///
    /// The result is at most one step towards the target, so that a single late frame has
    /// little effect.
    pub(crate) fn slide_ns(&mut self, start_ns: u64, is_driving: bool) -> i64 {
        let Some(arrival_ns) = self.arrival_ns.take() else {
            return 0;
        };
        let age_ns = start_ns.saturating_sub(arrival_ns) % self.period_ns;
        let step_ns = self.period_ns / if is_driving { SLOW } else { FAST };
        // Delay the tick if the frame arrived less than the margin before it, or if the
        // target is closer in that direction.
        let margin_ns = self.margin_ns() % self.period_ns;
        let late_ns = (age_ns + self.period_ns - margin_ns) % self.period_ns;
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
    fn from_any_phase_ticks_settle_at_the_margin_after_frames() {
        for phase in (0..PERIOD).step_by(250_000) {
            for age in &ages(PERIOD, phase, false, 60)[30..] {
                assert!(
                    age.abs_diff(LEAST_MARGIN_NS) <= PERIOD / FAST,
                    "{phase}: {age}"
                );
            }
        }
    }

    #[test]
    fn a_different_camera_clock_is_followed_while_driving() {
        for frame_period in [PERIOD - 10_000, PERIOD + 10_000] {
            let ages = ages(frame_period, 8_000_000, true, 20_000);
            for age in &ages[1_000..] {
                assert!(
                    age.abs_diff(LEAST_MARGIN_NS) < 100_000,
                    "{frame_period}: {age}"
                );
            }
        }
    }

    #[test]
    fn frames_that_arrive_unevenly_are_waited_for() {
        // Up to 0.8 ms late, in an order that repeats after 17 frames.
        let arrival = |frame: u64| frame * PERIOD + 8_000_000 + (frame * 5 % 17) * 50_000;
        let mut alignment = Alignment::new(PERIOD);
        let (mut frame, mut tick) = (0, 10 * PERIOD);
        for index in 0..6_000 {
            let before = frame;
            while arrival(frame + 1) <= tick {
                frame += 1;
            }
            alignment.arrived(arrival(frame));
            let age = tick - arrival(frame);
            assert!(
                index < 1_000 || frame == before + 1,
                "{index}: no frame, or two"
            );
            assert!(index < 1_000 || age < MOST_MARGIN_NS, "{index}: {age}");
            let slide = alignment.slide_ns(tick, true);
            tick = tick.saturating_add_signed(PERIOD as i64 + slide);
        }
    }

    #[test]
    fn one_late_frame_is_forgotten_within_seconds() {
        let mut alignment = Alignment::new(PERIOD);
        let mut margins = Vec::new();
        for frame in 1..2_000_u64 {
            let late = if frame == 10 { 1_000_000 } else { 0 };
            alignment.arrived(frame * PERIOD + late);
            margins.push(alignment.margin_ns());
        }
        assert_eq!(margins[8], LEAST_MARGIN_NS);
        assert_eq!(margins[9], LEAST_MARGIN_NS + 1_000_000);
        assert!(margins[1_500] < LEAST_MARGIN_NS + 100_000);
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
    fn without_frames_the_grid_does_not_slide() {
        let mut alignment = Alignment::new(PERIOD);
        assert_eq!(alignment.slide_ns(PERIOD, false), 0);
        alignment.arrived(PERIOD);
        assert_ne!(alignment.slide_ns(PERIOD + 5_000_000, false), 0);
        assert_eq!(alignment.slide_ns(2 * PERIOD, false), 0);
    }
}
