//! What happened to every datagram.

/// Counts since the session was made. Nothing resets them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct SessionCounters {
    /// Frames taken as the newest.
    pub frames: u64,
    /// Frame numbers that never arrived.
    pub lost: u64,
    /// Frames older than the newest: dropped.
    pub late: u64,
    /// Frames with the newest one's number: dropped.
    pub duplicates: u64,
    /// Times the server started its frame numbers again while its clock went on.
    pub renumbered: u64,
    /// Datagrams that could not be decoded.
    pub malformed: u64,
    /// Datagrams from another address.
    pub wrong_source: u64,
    /// Frames that contradict the stream: another port, other content for the same number, a
    /// clock ahead of time. Two senders use the server's address.
    pub contradictions: u64,
    /// Frames without a capture time because of contradictions just before.
    pub distrusted: u64,
    /// Frames before the bitstream was known: dropped.
    pub early: u64,
    /// Messages that answer no request.
    pub unsolicited: u64,
    /// Capture times moved back to the time of arrival, which they exceeded by no
    /// more than their uncertainty.
    pub capture_clamped: u64,
    /// Times the stream became stale.
    pub stale: u64,
    /// Times the session started over.
    pub restarts: u64,
    /// Echo exchanges used.
    pub echoes: u64,
    /// Times the clock mapping was discarded because an echo contradicted it.
    pub clock_steps: u64,
}
