//! A server's stamps in microseconds of its own clock.

use super::{
    echo::{EchoClock, EchoSample, SampleUse},
    ticks::{Mapped, difference, offset_by},
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
    least: LeastDelay,
}

/// The least delay between a stamp and its arrival since the connection began. It rises with the
/// clocks' largest drift alone: a delay that is added must show as age, and not as a new clock.
#[derive(Clone, Debug)]
struct LeastDelay {
    max_skew: f64,
    assumed_ns: u64,
    /// Stamp and arrival from which differences are taken, the least, and when it was renewed.
    known: Option<((u64, u64), f64, u64)>,
}

impl LeastDelay {
    fn observe(&mut self, stamp_us: u64, receive_ns: u64) {
        let (origin, least_ns, at_ns) =
            self.known
                .unwrap_or(((stamp_us, receive_ns), f64::INFINITY, receive_ns));
        let delay_ns =
            difference(receive_ns, origin.1) - difference(stamp_us, origin.0) * NS_PER_TICK;
        let drift_ns = difference(receive_ns, at_ns) * self.max_skew;
        self.known = Some((origin, delay_ns.min(least_ns + drift_ns), receive_ns));
    }

    fn map(&self, stamp_us: u64) -> Option<Mapped> {
        let ((origin_us, origin_ns), least_ns, _) = self.known?;
        let elapsed_ns = difference(stamp_us, origin_us) * NS_PER_TICK;
        Some(Mapped {
            local_ns: offset_by(origin_ns, elapsed_ns + least_ns - self.assumed_ns as f64),
            uncertainty_ns: self.assumed_ns,
        })
    }
}

impl StampClock {
    pub(crate) fn new(timing: &Timing) -> Self {
        let max_skew = timing.max_clock_skew_ppm * 1e-6;
        Self {
            echo: EchoClock::new(NS_PER_TICK, max_skew),
            least: LeastDelay {
                max_skew,
                assumed_ns: timing.assumed_latency_ns,
                known: None,
            },
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
