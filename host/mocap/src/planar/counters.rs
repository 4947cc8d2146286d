//! Counts of what the frames say of the body.

use crate::counters::SessionCounters;

use super::observation::RejectReason;

/// Counts since the session was made. Nothing resets them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct PlanarCounters {
    /// The camera session's counts.
    pub session: SessionCounters,
    /// Frames with an accepted pose.
    pub valid: u64,
    /// Frames in which the body is not tracked.
    pub untracked: u64,
    /// Frames without the body.
    pub absent: u64,
    /// Frames while the body's name had no id.
    pub unbound: u64,
    /// Frames with a rejected pose, by reason.
    pub rejected: RejectedCounts,
    /// Frames while the body was locked out. `rejected` counts them as well.
    pub locked_out: u64,
}

/// Rejected poses by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct RejectedCounts {
    /// See [`RejectReason::NotFinite`].
    pub not_finite: u64,
    /// See [`RejectReason::NotUnitQuaternion`].
    pub not_unit_quaternion: u64,
    /// See [`RejectReason::DuplicateId`].
    pub duplicate_id: u64,
    /// See [`RejectReason::MeanError`].
    pub mean_error: u64,
    /// See [`RejectReason::CaptureTime`].
    pub capture_time: u64,
    /// See [`RejectReason::Jump`].
    pub jump: u64,
    /// See [`RejectReason::Flip`].
    pub flip: u64,
}

impl RejectedCounts {
    pub(super) const fn count(&mut self, reason: RejectReason) {
        let counter = match reason {
            RejectReason::NotFinite => &mut self.not_finite,
            RejectReason::NotUnitQuaternion => &mut self.not_unit_quaternion,
            RejectReason::DuplicateId => &mut self.duplicate_id,
            RejectReason::MeanError => &mut self.mean_error,
            RejectReason::CaptureTime => &mut self.capture_time,
            RejectReason::Jump => &mut self.jump,
            RejectReason::Flip => &mut self.flip,
        };
        *counter += 1;
    }

    /// The sum of all reasons.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.not_finite
            + self.not_unit_quaternion
            + self.duplicate_id
            + self.mean_error
            + self.capture_time
            + self.jump
            + self.flip
    }
}
