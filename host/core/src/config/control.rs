//! `[control]`: how the controller runs.

use singletrack_settings::section;

section! {
    /// How the controller runs.
    "control" => pub ControlSection: Copy;
    [default];

    // Faster than 200 Hz the commands fill the line; slower than 20 Hz the board's 95 ms
    // leave no room for one that is lost.
    /// Period of the controller.
    @restart period_ms: u32 = 10, in 5..=50;
    /// A frame that arrives up to 3 ms before the deadline of a tick begins it, and the deadlines
    /// slide slowly to keep frames there. Poses are then fresh, and no tick goes without one
    /// because the clocks of cameras and host drift.
    @restart align_to_cameras: bool = true;
    /// Deceleration of a commanded stop.
    stop_deceleration_m_s2: f64 = 2.4, in up_to(50.0);
    /// `SCHED_FIFO` priority of the control thread, if the system grants it (`LimitRTPRIO=`);
    /// 0 does not request it. The threads that read board and cameras have one less.
    @restart realtime_priority: u8 = 40, in 0..=90;
}

impl ControlSection {
    /// The period, in ns.
    #[must_use]
    pub fn period_ns(&self) -> u64 {
        u64::from(self.period_ms) * 1_000_000
    }
}
