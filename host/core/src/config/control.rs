//! `[control]`: how the controller runs.

use core::time::Duration;

use serde::{Deserialize, Serialize};

use super::{ConfigError, check};

/// How the controller runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControlSection {
    /// Period of the controller.
    pub period_ms: u32,
    /// Whether ticks slide, slowly, to where frames have just arrived.
    pub align_to_cameras: bool,
    /// Deceleration of a stop.
    pub stop_deceleration_m_s2: f64,
    /// `SCHED_FIFO` priority of the control thread, if the system grants it;
    /// 0 does not ask.
    pub realtime_priority: u8,
}

impl Default for ControlSection {
    fn default() -> Self {
        Self {
            period_ms: 10,
            align_to_cameras: true,
            stop_deceleration_m_s2: 2.4,
            realtime_priority: 40,
        }
    }
}

impl ControlSection {
    /// The period.
    #[must_use]
    pub fn period(&self) -> Duration {
        Duration::from_millis(self.period_ms.into())
    }

    /// The period, in ns.
    #[must_use]
    pub fn period_ns(&self) -> u64 {
        u64::from(self.period_ms) * 1_000_000
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        // Faster than 200 Hz the commands fill the line; slower than 20 Hz the
        // board's 95 ms leave no room for one that is lost.
        check::within("control.period_ms", self.period_ms, 5..=50)?;
        check::positive(
            "control.stop_deceleration_m_s2",
            self.stop_deceleration_m_s2,
            50.0,
        )?;
        check::within("control.realtime_priority", self.realtime_priority, 0..=90)
    }
}
