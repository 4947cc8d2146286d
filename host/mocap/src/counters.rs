//! What happened to every datagram.

use crate::pose::RejectReason;

/// Counts since the session began; nothing resets them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames taken as the newest.
    pub frames: u64,
    /// Frames with a valid pose.
    pub valid: u64,
    /// Frame numbers never seen.
    pub lost: u64,
    /// Frames older than the newest: dropped.
    pub late: u64,
    /// Frames with the newest one's number: dropped.
    pub duplicates: u64,
    /// Times the server started its frame numbers again with its clock going on.
    pub renumbered: u64,
    /// Datagrams that could not be decoded.
    pub malformed: u64,
    /// Datagrams from another address.
    pub wrong_source: u64,
    /// Frames before the bitstream was known: dropped.
    pub early: u64,
    /// Messages that nothing had asked for.
    pub unsolicited: u64,
    /// Frames with the body untracked.
    pub untracked: u64,
    /// Frames without the body.
    pub absent: u64,
    /// Frames while no body was bound.
    pub unbound: u64,
    /// Frames with a pose not believed, by reason.
    pub rejected: RejectedCounts,
    /// Frames while the body was locked out; counted in `rejected` as well.
    pub locked_out: u64,
    /// Capture times moved back to the time of reception, which they exceeded by
    /// no more than their uncertainty.
    pub capture_clamped: u64,
    /// Times the stream became stale.
    pub stale: u64,
    /// Times the session began anew.
    pub restarts: u64,
    /// Echo exchanges used.
    pub echoes: u64,
    /// Times the clock mapping was thrown away because an echo contradicted it.
    pub clock_steps: u64,
    /// Events that nobody fetched in time.
    pub events_dropped: u64,
}

/// Rejected poses by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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
    pub(crate) const fn count(&mut self, reason: RejectReason) {
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

    /// All reasons together.
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
