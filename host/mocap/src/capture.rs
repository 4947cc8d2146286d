//! When a frame was captured, in local time.

use singletrack_words::words;

/// The capture time of a frame on the local clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct CaptureTime {
    /// The middle of the exposure, in nanoseconds of the local clock. It is never
    /// after the frame's arrival.
    pub time_ns: u64,
    /// Bound on the error of `time_ns`, in nanoseconds.
    pub uncertainty_ns: u64,
    /// How `time_ns` was found.
    pub source: CaptureTimeSource,
}

impl CaptureTime {
    /// The capture of a frame that arrived at `now_ns`, less a constant error of the stamps: never
    /// after it arrived, with whether it had to be moved back for that. `None` if it exceeds the
    /// arrival by more than its uncertainty.
    pub(crate) const fn at_arrival(mut self, now_ns: u64, offset_ns: i64) -> Option<(Self, bool)> {
        self.time_ns = self.time_ns.saturating_sub_signed(offset_ns);
        if self.time_ns <= now_ns {
            return Some((self, false));
        }
        if self.time_ns - now_ns > self.uncertainty_ns {
            return None;
        }
        self.time_ns = now_ns;
        Some((self, true))
    }
}

words! {
    /// How a capture time was found, best first.
    ///
    /// This enum is exhaustive: a new source is a breaking change, because every user
    /// must decide whether it trusts it.
    pub enum CaptureTimeSource {
        /// Mid-exposure time, mapped by echo exchanges. The uncertainty is a bound. With VRPN it
        /// is the server's stamp of the report: what it stamps is the server's business.
        MidExposureEcho = "mid-exposure-echo",
        /// Mid-exposure time, mapped by the least delay observed between sending and
        /// receiving. The uncertainty rests on an assumed network delay.
        MidExposureMinDelay = "mid-exposure-min-delay",
        /// The frame's timestamp, mapped by the least delay observed: the server does
        /// not send mid-exposure time. The uncertainty rests on an assumed latency.
        FrameTimestamp = "frame-timestamp",
    }
}
