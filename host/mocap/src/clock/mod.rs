//! The server's clock on the local one: when a frame was captured.

mod echo;
mod min_delay;

use core::num::NonZeroU64;

use crate::codec::Frame;
use crate::config::Timing;
use crate::pose::CaptureTimeSource;

pub(crate) use echo::{EchoClock, EchoSample, SampleUse};
use min_delay::MinDelay;

/// A time of the server on the local clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Mapped {
    pub(crate) local_ns: u64,
    pub(crate) uncertainty_ns: u64,
}

/// When a frame was captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Capture {
    pub(crate) time_ns: u64,
    pub(crate) uncertainty_ns: u64,
    pub(crate) source: CaptureTimeSource,
}

/// Everything known of one server's clock.
#[derive(Debug, Clone)]
pub(crate) struct CaptureClock {
    echo: Option<EchoClock>,
    transmit: Option<MinDelay>,
    timestamp: MinDelay,
}

impl CaptureClock {
    /// The clock of a server that ticks so often a second, if it says so.
    pub(crate) fn new(ticks_per_second: Option<NonZeroU64>, timing: &Timing) -> Self {
        let max_skew = timing.max_clock_skew_ppm * 1e-6;
        let ns_per_tick = ticks_per_second.map(|ticks| 1e9 / ticks.get() as f64);
        Self {
            echo: ns_per_tick.map(|ns_per_tick| EchoClock::new(ns_per_tick, max_skew)),
            transmit: ns_per_tick.map(|ns_per_tick| {
                MinDelay::new(ns_per_tick, max_skew, timing.assumed_network_delay_ns)
            }),
            timestamp: MinDelay::new(1.0, max_skew, timing.assumed_latency_ns),
        }
    }

    pub(crate) const fn echo_mut(&mut self) -> Option<&mut EchoClock> {
        self.echo.as_mut()
    }

    /// The server's clock when it sent the frame, to put frames in order; 0 when
    /// the frame does not tell.
    pub(crate) fn order_key(frame: &Frame<'_>) -> u64 {
        match frame.ticks {
            Some(ticks) if ticks.transmit != 0 => ticks.transmit,
            _ => timestamp_ns(frame.timestamp_s).unwrap_or_default(),
        }
    }

    /// Learns from a frame, and says when it was captured.
    pub(crate) fn capture(&mut self, frame: &Frame<'_>, receive_ns: u64) -> Option<Capture> {
        let timestamp = timestamp_ns(frame.timestamp_s);
        if let Some(timestamp) = timestamp {
            self.timestamp.observe(timestamp, receive_ns);
        }
        let ticks = frame.ticks.unwrap_or_default();
        if let (Some(transmit), true) = (&mut self.transmit, ticks.transmit != 0) {
            transmit.observe(ticks.transmit, receive_ns);
        }
        if ticks.mid_exposure != 0 {
            let by_echo = self
                .echo
                .as_ref()
                .and_then(|echo| echo.map(ticks.mid_exposure));
            if let Some(mapped) = by_echo {
                return Some(mapped.captured(CaptureTimeSource::MidExposureEcho));
            }
            let by_delay = self
                .transmit
                .as_ref()
                .and_then(|transmit| transmit.map(ticks.mid_exposure));
            if let Some(mapped) = by_delay {
                return Some(mapped.captured(CaptureTimeSource::MidExposureMinDelay));
            }
        }
        let mapped = self.timestamp.map(timestamp?)?;
        Some(mapped.captured(CaptureTimeSource::FrameTimestamp))
    }
}

impl Mapped {
    const fn captured(self, source: CaptureTimeSource) -> Capture {
        Capture {
            time_ns: self.local_ns,
            uncertainty_ns: self.uncertainty_ns,
            source,
        }
    }
}

/// A timestamp in whole nanoseconds, if it is one.
fn timestamp_ns(timestamp_s: f64) -> Option<u64> {
    // 1e10 s are 300 years; far below what nanoseconds in u64 hold.
    (timestamp_s.is_finite() && (0.0..1e10).contains(&timestamp_s))
        .then_some((timestamp_s * 1e9) as u64)
}

/// `to - from` of two readings of a wrapping counter, as a number.
const fn difference(to: u64, from: u64) -> f64 {
    to.wrapping_sub(from).cast_signed() as f64
}

/// `base` moved by a number of nanoseconds, within what the type holds.
fn offset_by(base: u64, ns: f64) -> u64 {
    // The conversion saturates.
    base.saturating_add_signed(libm::round(ns) as i64)
}
