//! A server's stamps in microseconds of its own clock.

use super::{
    echo::{EchoClock, EchoSample, SampleUse},
    min_delay::MinDelay,
};
use crate::{
    capture::{CaptureTime, CaptureTimeSource},
    config::Timing,
};

const NS_PER_TICK: f64 = 1_000.0;

/// What is known of a clock that stamps frames, and answers when it is asked or never does.
#[derive(Clone, Debug)]
pub(crate) struct StampClock {
    echo: EchoClock,
    least: MinDelay,
}

impl StampClock {
    pub(crate) fn new(timing: &Timing) -> Self {
        let max_skew = timing.max_clock_skew_ppm * 1e-6;
        Self {
            echo: EchoClock::new(NS_PER_TICK, max_skew),
            least: MinDelay::new(NS_PER_TICK, max_skew, timing.assumed_latency_ns),
        }
    }

    /// The number of exchanges that are in use.
    pub(crate) const fn exchanges(&self) -> usize {
        self.echo.len()
    }

    /// The server's clock showed `stamp_us` between two local times.
    pub(crate) fn exchanged(&mut self, sent_ns: u64, received_ns: u64, stamp_us: u64) -> SampleUse {
        self.echo.add(EchoSample {
            sent_ns,
            received_ns,
            server_ticks: stamp_us,
        })
    }

    /// Learns from a frame, and returns when it was captured.
    pub(crate) fn capture(&mut self, stamp_us: u64, receive_ns: u64) -> Option<CaptureTime> {
        self.least.observe(stamp_us, receive_ns);
        let by_echo = self.echo.map(stamp_us);
        let source = match by_echo {
            Some(_) => CaptureTimeSource::MidExposureEcho,
            None => CaptureTimeSource::FrameTimestamp,
        };
        let mapped = by_echo.or_else(|| self.least.map(stamp_us))?;
        Some(super::captured(mapped, source))
    }
}
