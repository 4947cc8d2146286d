//! When the ticks are due: a grid of deadlines, and its slow slide to the frames of the cameras.

/// The place of a tick on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// When the tick was due: at its deadline, or earlier, when a frame arrived.
    pub scheduled_ns: u64,
    /// The deadline of the tick.
    pub deadline_ns: u64,
    /// When the thread woke up.
    pub start_ns: u64,
    /// The number of deadlines skipped just before this one.
    pub skipped: u32,
}

/// The deadlines of the ticks, a period apart.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    /// The next deadline.
    pub next_ns: u64,
    period_ns: u64,
    /// Deadlines that passed during the last tick.
    overrun: u64,
}

impl Grid {
    /// A grid with its first deadline a period after `now_ns`.
    pub const fn new(now_ns: u64, period_ns: u64) -> Self {
        Self {
            next_ns: now_ns.saturating_add(period_ns),
            period_ns,
            overrun: 0,
        }
    }

    /// Moves all future deadlines by `by_ns`.
    pub const fn slide(&mut self, by_ns: i64) {
        self.next_ns = self.next_ns.saturating_add_signed(by_ns);
    }

    /// A tick ended at `now_ns`: the deadlines that passed during it are skipped.
    pub fn leave(&mut self, now_ns: u64) {
        if now_ns > self.next_ns {
            self.overrun = (now_ns - self.next_ns) / self.period_ns + 1;
            self.next_ns += self.overrun * self.period_ns;
        }
    }

    /// The slot of a thread that woke up at `now_ns` for a tick that was due at `due_ns`, the
    /// next deadline or earlier. If later deadlines have passed too, the tick is that of the last
    /// of them, and the others are skipped.
    pub fn enter(&mut self, now_ns: u64, due_ns: u64) -> Slot {
        let skipped = now_ns.saturating_sub(self.next_ns) / self.period_ns;
        let deadline_ns = self.next_ns + skipped * self.period_ns;
        self.next_ns = deadline_ns + self.period_ns;
        let scheduled_ns = if skipped == 0 {
            due_ns.min(deadline_ns)
        } else {
            deadline_ns
        };
        let skipped = skipped + core::mem::take(&mut self.overrun);
        Slot {
            scheduled_ns,
            deadline_ns,
            start_ns: now_ns,
            skipped: u32::try_from(skipped).unwrap_or(u32::MAX),
        }
    }
}

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
    /// The period of the ticks, ns.
    pub(crate) period_ns: u64,
    /// The time before a deadline in which a frame begins the tick, ns.
    pub(crate) window_ns: u64,
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

    /// A frame arrived.
    pub(crate) const fn arrived(&mut self, time_ns: u64) {
        self.arrival_ns = Some(time_ns);
    }

    /// The delay of the next deadline beyond a period after this one, in ns; negative to
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

    /// Enters without a frame.
    fn enter(grid: &mut Grid, now_ns: u64) -> Slot {
        let due_ns = grid.next_ns;
        grid.enter(now_ns, due_ns)
    }

    #[test]
    fn a_tick_that_overruns_deadlines_skips_them() {
        let mut grid = Grid::new(1_000, 100);
        enter(&mut grid, 1_100);
        grid.leave(1_190);
        assert_eq!(grid.next_ns, 1_200);
        enter(&mut grid, 1_200);
        grid.leave(1_510);
        assert_eq!(grid.next_ns, 1_600);
        let after = enter(&mut grid, 1_601);
        assert_eq!((after.scheduled_ns, after.skipped), (1_600, 3));
        grid.leave(1_650);
        assert_eq!(enter(&mut grid, 1_700).skipped, 0);
    }

    #[test]
    fn a_thread_that_wakes_late_skips_deadlines_and_keeps_the_grid() {
        let mut grid = Grid::new(1_000, 100);
        let on_time = enter(&mut grid, 1_103);
        assert_eq!((on_time.scheduled_ns, on_time.skipped), (1_100, 0));
        let late = enter(&mut grid, 1_299);
        assert_eq!((late.scheduled_ns, late.skipped), (1_200, 0));
        let overrun = enter(&mut grid, 1_650);
        assert_eq!((overrun.scheduled_ns, overrun.skipped), (1_600, 3));
        assert_eq!(grid.next_ns, 1_700);
        let stalled = enter(&mut grid, 1_000_000_050);
        assert_eq!(stalled.scheduled_ns, 1_000_000_000);
    }

    #[test]
    fn a_tick_that_begins_before_its_deadline_keeps_the_grid() {
        let mut grid = Grid::new(1_000, 100);
        let early = grid.enter(1_081, 1_080);
        assert_eq!((early.scheduled_ns, early.deadline_ns), (1_080, 1_100));
        assert_eq!((early.skipped, grid.next_ns), (0, 1_200));
        // Due early, but the thread woke up after later deadlines.
        let late = grid.enter(1_450, 1_190);
        assert_eq!((late.scheduled_ns, late.deadline_ns), (1_400, 1_400));
        assert_eq!((late.skipped, grid.next_ns), (2, 1_500));
    }

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
        assert_eq!(Alignment::new(PERIOD).window_ns, 3_000_000);
        assert_eq!(Alignment::new(PERIOD / 2).window_ns, 1_500_000);
        assert_eq!(Alignment::new(5 * PERIOD).window_ns, 3_000_000);
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
