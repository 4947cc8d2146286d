//! Alignment of the ticks with the camera frames, so that a tick has a fresh pose.
//!
//! Cameras and controller both run at 100 Hz, each by its own clock. A frame begins the tick that
//! waits for it, if it arrives within a window before the deadline of the tick: see
//! [`ControlLoop::due_ns`](crate::control_loop::ControlLoop::due_ns). The grid of the deadlines
//! slides slowly, until frames arrive in the middle of the window. There is room then for frames
//! that come unevenly, and the drift of the clocks leaves no tick without a frame, and none with
//! two.

/// The longest window, ns.
const MOST_WINDOW_NS: u64 = 3_000_000;

/// The longest window is this part of a period: ticks stay nearly a period apart.
const WINDOW_PART: (u64, u64) = (3, 10);

/// While the car does not drive, a step of the grid is at most the period over this.
const FAST: u64 = 20;

/// While the car drives, a step is at most the period over this: too small to matter for
/// the control period, and large enough to follow clocks that differ by 0.2 %.
const SLOW: u64 = 500;

/// Computes the slides of the grid from the arrivals of frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alignment {
    period_ns: u64,
    window_ns: u64,
    /// When the newest frame arrived, if that was since the last tick.
    arrival_ns: Option<u64>,
}

impl Alignment {
    pub(crate) fn new(period_ns: u64) -> Self {
        let part_ns = period_ns * WINDOW_PART.0 / WINDOW_PART.1;
        Self {
            period_ns,
            window_ns: part_ns.min(MOST_WINDOW_NS),
            arrival_ns: None,
        }
    }

    /// The period of the ticks, ns.
    pub(crate) const fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The time before a deadline in which a frame begins the tick, ns.
    pub(crate) const fn window_ns(&self) -> u64 {
        self.window_ns
    }

    /// A frame arrived.
    pub(crate) const fn arrived(&mut self, time_ns: u64) {
        self.arrival_ns = Some(time_ns);
    }

    /// By how much to delay the next deadline beyond a period after this one, in ns; negative to
    /// advance it. 0 if no frame has arrived since the last call.
    ///
    /// The result is at most one step towards the target, so that a single late frame has
    /// little effect.
    pub(crate) fn slide_ns(&mut self, deadline_ns: u64, is_driving: bool) -> i64 {
        let Some(arrival_ns) = self.arrival_ns.take() else {
            return 0;
        };
        let step_ns = self.period_ns / if is_driving { SLOW } else { FAST };
        // Frames are to arrive half a window before the deadlines. Delay the next one if this
        // one arrived later, or if the target is closer in that direction.
        let target_ns = arrival_ns.saturating_add(self.window_ns / 2);
        let ahead_ns = if target_ns >= deadline_ns {
            (target_ns - deadline_ns) % self.period_ns
        } else {
            self.period_ns - (deadline_ns - target_ns) % self.period_ns
        };
        let (distance_ns, sign) = if ahead_ns <= self.period_ns / 2 {
            (ahead_ns, 1)
        } else {
            (self.period_ns - ahead_ns, -1)
        };
        sign * i64::try_from(distance_ns.min(step_ns)).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = 10_000_000;
    const TARGET: u64 = MOST_WINDOW_NS / 2;

    /// Ages of the newest frame at the deadlines of a run, in ns.
    fn ages(frame_period: u64, phase: u64, driving: bool, ticks: usize) -> Vec<u64> {
        let mut alignment = Alignment::new(PERIOD);
        let mut frame = phase;
        let mut deadline = 10 * PERIOD;
        (0..ticks)
            .map(|_| {
                while frame + frame_period <= deadline {
                    frame += frame_period;
                }
                let age = deadline - frame;
                alignment.arrived(frame);
                let slide = alignment.slide_ns(deadline, driving);
                deadline = deadline.saturating_add_signed(PERIOD as i64 + slide);
                age
            })
            .collect()
    }

    #[test]
    fn from_any_phase_frames_settle_in_the_middle_of_the_window() {
        for phase in (0..PERIOD).step_by(250_000) {
            for age in &ages(PERIOD, phase, false, 60)[30..] {
                assert!(age.abs_diff(TARGET) <= PERIOD / FAST, "{phase}: {age}");
            }
        }
    }

    #[test]
    fn a_different_camera_clock_is_followed_while_driving() {
        for frame_period in [PERIOD - 10_000, PERIOD + 10_000] {
            let ages = ages(frame_period, 8_000_000, true, 20_000);
            for age in &ages[1_000..] {
                assert!(age.abs_diff(TARGET) < 100_000, "{frame_period}: {age}");
            }
        }
    }

    #[test]
    fn frames_that_arrive_unevenly_stay_in_the_window() {
        // Up to 1.6 ms late, in an order that repeats after 17 frames.
        let arrival = |frame: u64| frame * PERIOD + 8_000_000 + (frame * 5 % 17) * 100_000;
        let mut alignment = Alignment::new(PERIOD);
        let (mut frame, mut deadline) = (0, 10 * PERIOD);
        for index in 0..6_000 {
            let before = frame;
            while arrival(frame + 1) <= deadline {
                frame += 1;
            }
            alignment.arrived(arrival(frame));
            let age = deadline - arrival(frame);
            assert!(
                index < 1_000 || frame == before + 1,
                "{index}: no frame, or two"
            );
            assert!(index < 1_000 || age < MOST_WINDOW_NS, "{index}: {age}");
            let slide = alignment.slide_ns(deadline, true);
            deadline = deadline.saturating_add_signed(PERIOD as i64 + slide);
        }
    }

    #[test]
    fn a_frame_that_arrives_after_the_deadline_delays_the_next() {
        let mut alignment = Alignment::new(PERIOD);
        alignment.arrived(PERIOD + 1);
        assert_eq!(alignment.slide_ns(PERIOD, true), (PERIOD / SLOW) as i64);
    }

    #[test]
    fn the_window_of_a_short_period_is_short() {
        assert_eq!(Alignment::new(PERIOD).window_ns(), 3_000_000);
        assert_eq!(Alignment::new(PERIOD / 2).window_ns(), 1_500_000);
        assert_eq!(Alignment::new(5 * PERIOD).window_ns(), 3_000_000);
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
