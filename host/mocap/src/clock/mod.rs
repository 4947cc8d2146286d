//! Maps the server's clock to the local one: when a frame was captured.

mod echo;
mod min_delay;
mod stamp;
mod ticks;

use core::num::NonZeroU64;

use crate::{
    capture::{CaptureTime, CaptureTimeSource},
    codec::Frame,
    config::Timing,
};
use echo::EchoClock;
pub(crate) use echo::{EchoSample, SampleUse};
use min_delay::MinDelay;
pub(crate) use stamp::StampClock;
use ticks::Mapped;

/// What is known of one server's clock.
#[derive(Clone, Debug)]
pub(crate) struct CaptureClock {
    echo: Option<EchoClock>,
    transmit: Option<MinDelay>,
    timestamp: MinDelay,
}

impl CaptureClock {
    /// The clock of a server; `ticks_per_second` is `None` when the server does not
    /// send its clock's frequency.
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
    /// the frame does not carry it.
    pub(crate) fn order_key(frame: &Frame<'_>) -> u64 {
        match frame.ticks {
            Some(ticks) if ticks.transmit != 0 => ticks.transmit,
            _ => timestamp_ns(frame.timestamp_s).unwrap_or_default(),
        }
    }

    /// Learns from a frame, and returns when it was captured.
    pub(crate) fn capture(&mut self, frame: &Frame<'_>, receive_ns: u64) -> Option<CaptureTime> {
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
                return Some(captured(mapped, CaptureTimeSource::MidExposureEcho));
            }
            let by_delay = self
                .transmit
                .as_ref()
                .and_then(|transmit| transmit.map(ticks.mid_exposure));
            if let Some(mapped) = by_delay {
                return Some(captured(mapped, CaptureTimeSource::MidExposureMinDelay));
            }
        }
        let mapped = self.timestamp.map(timestamp?)?;
        Some(captured(mapped, CaptureTimeSource::FrameTimestamp))
    }
}

const fn captured(mapped: Mapped, source: CaptureTimeSource) -> CaptureTime {
    CaptureTime {
        time_ns: mapped.local_ns,
        uncertainty_ns: mapped.uncertainty_ns,
        source,
    }
}

/// A timestamp in whole nanoseconds, if it is one.
fn timestamp_ns(timestamp_s: f64) -> Option<u64> {
    // 1e10 s are 300 years; far below what nanoseconds in u64 hold.
    (timestamp_s.is_finite() && (0.0..1e10).contains(&timestamp_s))
        .then_some((timestamp_s * 1e9) as u64)
}
