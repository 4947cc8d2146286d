//! Maps the server's clock to the local one: when a frame was captured.
//!
//! Each echo exchange proves that the server's clock showed some ticks at a
//! local time between sending the request and receiving the answer.
//!
//! How the round trip divides into the way there and the way back is not assumed:
//! an exchange bounds the local time to plus or minus half of the round trip. Moved
//! along by the clocks' rates, all bounds hold at once, so their intersection holds
//! too. Its middle is the estimate, and half its width is the uncertainty.
//!
//! Without echoes, the least delay seen between the server's stamp and the arrival of the frame, less
//! an assumed delay, relates the two clocks.

use core::num::NonZeroU64;

use crate::{
    body::{CaptureTime, CaptureTimeSource},
    codec::Frame,
    config::Timing,
};

/// What is known of one server's clock.
#[derive(Clone, Debug)]
pub(crate) struct CaptureClock {
    /// From exchanges, with a server that answers them.
    pub(crate) echo: Option<EchoClock>,
    transmit: Option<MinDelay>,
    timestamp: MinDelay,
}

impl CaptureClock {
    /// The clock of a server; `ticks_per_second` is `None` when the server does not
    /// send its clock's frequency.
    pub(crate) fn new(ticks_per_second: Option<NonZeroU64>, timing: &Timing) -> Self {
        let max_skew = timing.max_clock_skew_ppm * 1e-6;
        let ns_per_tick = ticks_per_second.map(|ticks| 1e9 / ticks.get() as f64);
        let least = |ns_per_tick, assumed_delay_ns, source| MinDelay {
            ns_per_tick,
            max_skew,
            assumed_delay_ns,
            source,
            windows: None,
        };
        let (network_ns, latency_ns) = (timing.assumed_network_delay_ns, timing.assumed_latency_ns);
        let by_delay = CaptureTimeSource::MidExposureMinDelay;
        Self {
            echo: ns_per_tick.map(|ns_per_tick| EchoClock::new(ns_per_tick, max_skew)),
            transmit: ns_per_tick.map(|ns_per_tick| least(ns_per_tick, network_ns, by_delay)),
            timestamp: least(1.0, latency_ns, CaptureTimeSource::FrameTimestamp),
        }
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
        let exposed = Some(ticks.mid_exposure).filter(|ticks| *ticks != 0);
        let by_echo = || self.echo.as_ref()?.map(exposed?);
        let by_delay = || self.transmit.as_ref()?.map(exposed?);
        let by_timestamp = || self.timestamp.map(timestamp?);
        by_echo().or_else(by_delay).or_else(by_timestamp)
    }
}

/// The time `ns` after `base_ns`, within the type's range.
fn captured(base_ns: u64, ns: f64, uncertainty_ns: u64, source: CaptureTimeSource) -> CaptureTime {
    CaptureTime {
        // The conversion saturates.
        time_ns: base_ns.saturating_add_signed(libm::round(ns) as i64),
        uncertainty_ns,
        source,
    }
}

/// A timestamp in whole nanoseconds, if it is one.
fn timestamp_ns(timestamp_s: f64) -> Option<u64> {
    // 1e10 s are 300 years; far below what nanoseconds in u64 hold.
    (timestamp_s.is_finite() && (0.0..1e10).contains(&timestamp_s))
        .then_some((timestamp_s * 1e9) as u64)
}

const SAMPLES: usize = 32;

/// Two exchanges give a rate only when they are this far apart.
const MIN_BASELINE_NS: f64 = 1e9;

/// One exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EchoSample {
    pub(crate) sent_ns: u64,
    pub(crate) received_ns: u64,
    pub(crate) server_ticks: u64,
}

/// The effect of an exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SampleUse {
    /// It agrees with the others.
    Agreed,
    /// It contradicts the others, which were dropped.
    Stepped,
    /// The server's clock went backward: it is another server.
    Backward,
}

#[derive(Clone, Debug)]
pub(crate) struct EchoClock {
    samples: heapless::Deque<EchoSample, SAMPLES>,
    ns_per_tick: f64,
    max_skew: f64,
    skew: f64,
    skew_uncertainty: f64,
}

/// A local time relative to some origin, and a bound on its error, in ns.
#[derive(Clone, Copy, Debug)]
struct Bound {
    middle: f64,
    half_width: f64,
}

impl EchoClock {
    pub(crate) const fn new(ns_per_tick: f64, max_skew: f64) -> Self {
        Self {
            samples: heapless::Deque::new(),
            ns_per_tick,
            max_skew,
            skew: 0.0,
            skew_uncertainty: max_skew,
        }
    }

    pub(crate) const fn len(&self) -> usize {
        self.samples.len()
    }

    pub(crate) fn add(&mut self, sample: EchoSample) -> SampleUse {
        if let Some(newest) = self.samples.back()
            && difference(sample.server_ticks, newest.server_ticks) < 0.0
        {
            return SampleUse::Backward;
        }
        let contradicts = self
            .estimate(sample.server_ticks, sample.sent_ns)
            .is_some_and(|predicted| {
                let measured = self.bound(&sample, sample.server_ticks, sample.sent_ns);
                libm::fabs(predicted.middle - measured.middle)
                    > predicted.half_width + measured.half_width
            });
        let mut outcome = SampleUse::Agreed;
        if contradicts {
            self.samples.clear();
            outcome = SampleUse::Stepped;
        }
        if self.samples.is_full() {
            self.samples.pop_front();
        }
        // Room was made above.
        let _ = self.samples.push_back(sample);
        self.fit_skew();
        outcome
    }

    /// The local time at which the server's clock shows these ticks.
    fn map(&self, server_ticks: u64) -> Option<CaptureTime> {
        let origin_ns = self.samples.back()?.received_ns;
        let bound = self.estimate(server_ticks, origin_ns)?;
        let (within_ns, source) = (bound.half_width, CaptureTimeSource::MidExposureEcho);
        let uncertainty_ns = libm::ceil(within_ns) as u64;
        Some(captured(origin_ns, bound.middle, uncertainty_ns, source))
    }

    fn estimate(&self, server_ticks: u64, origin_ns: u64) -> Option<Bound> {
        let mut tightest: Option<Bound> = None;
        let mut lower = f64::NEG_INFINITY;
        let mut upper = f64::INFINITY;
        for sample in &self.samples {
            let bound = self.bound(sample, server_ticks, origin_ns);
            lower = lower.max(bound.middle - bound.half_width);
            upper = upper.min(bound.middle + bound.half_width);
            if tightest.is_none_or(|tightest| bound.half_width < tightest.half_width) {
                tightest = Some(bound);
            }
        }
        if lower <= upper {
            tightest.map(|_| Bound {
                middle: (lower + upper) / 2.0,
                half_width: (upper - lower) / 2.0 + self.ns_per_tick,
            })
        } else {
            // The rate changed within the window: use the best exchange alone.
            tightest
        }
    }

    /// The bound that one exchange gives on the local time of `server_ticks`.
    fn bound(&self, sample: &EchoSample, server_ticks: u64, origin_ns: u64) -> Bound {
        let elapsed_ns = difference(server_ticks, sample.server_ticks) * self.ns_per_tick;
        Bound {
            middle: self.middle(sample, origin_ns) + elapsed_ns * (1.0 + self.skew),
            half_width: self.half_width(sample) + libm::fabs(elapsed_ns) * self.skew_uncertainty,
        }
    }

    fn middle(&self, sample: &EchoSample, origin_ns: u64) -> f64 {
        difference(sample.sent_ns, origin_ns) + difference(sample.received_ns, sample.sent_ns) / 2.0
    }

    /// Half the round trip, and one tick: the server's clock is rounded to it.
    fn half_width(&self, sample: &EchoSample) -> f64 {
        difference(sample.received_ns, sample.sent_ns) / 2.0 + self.ns_per_tick
    }

    /// The rate from the pair of exchanges that bounds it best.
    fn fit_skew(&mut self) {
        let mut best = (0.0, self.max_skew);
        for (index, old) in self.samples.iter().enumerate() {
            for new in self.samples.iter().skip(index + 1) {
                let server_ns = difference(new.server_ticks, old.server_ticks) * self.ns_per_tick;
                if server_ns < MIN_BASELINE_NS {
                    continue;
                }
                let local_ns = self.middle(new, old.sent_ns) - self.middle(old, old.sent_ns);
                let uncertainty = (self.half_width(old) + self.half_width(new)) / server_ns;
                if uncertainty < best.1 {
                    best = (local_ns / server_ns - 1.0, uncertainty);
                }
            }
        }
        (self.skew, self.skew_uncertainty) = best;
    }
}

/// The least delay is taken over the current window and the one before it: long
/// enough to catch a quick frame, short enough that the clocks do not drift apart.
const WINDOW_NS: u64 = 1_000_000_000;

#[derive(Clone, Debug)]
struct MinDelay {
    ns_per_tick: f64,
    max_skew: f64,
    assumed_delay_ns: u64,
    /// What its times are called.
    source: CaptureTimeSource,
    windows: Option<Windows>,
}

#[derive(Clone, Copy, Debug)]
struct Windows {
    /// Ticks and local time that differences are taken from.
    origin: (u64, u64),
    began_ns: u64,
    current_ns: f64,
    previous_ns: f64,
}

impl MinDelay {
    /// Takes a stamp of the server and its time of arrival.
    fn observe(&mut self, ticks: u64, receive_ns: u64) {
        let windows = self.windows.get_or_insert(Windows {
            origin: (ticks, receive_ns),
            began_ns: receive_ns,
            current_ns: 0.0,
            previous_ns: f64::INFINITY,
        });
        let (origin_ticks, origin_ns) = windows.origin;
        let delay_ns =
            difference(receive_ns, origin_ns) - difference(ticks, origin_ticks) * self.ns_per_tick;
        let age_ns = receive_ns.saturating_sub(windows.began_ns);
        if age_ns >= WINDOW_NS {
            let (is_recent, last_ns) = (age_ns < 2 * WINDOW_NS, windows.current_ns);
            windows.previous_ns = if is_recent { last_ns } else { f64::INFINITY };
            windows.current_ns = delay_ns;
            windows.began_ns = receive_ns;
        } else {
            windows.current_ns = windows.current_ns.min(delay_ns);
        }
    }

    /// The local time at which the server's clock showed these ticks.
    fn map(&self, ticks: u64) -> Option<CaptureTime> {
        let windows = self.windows?;
        let (origin_ticks, origin_ns) = windows.origin;
        let elapsed_ns = difference(ticks, origin_ticks) * self.ns_per_tick;
        let least_ns = windows.current_ns.min(windows.previous_ns);
        let local_ns = elapsed_ns + least_ns - self.assumed_delay_ns as f64;
        let drift_ns = self.max_skew * (2 * WINDOW_NS) as f64;
        let uncertainty_ns = self.assumed_delay_ns.saturating_add(drift_ns as u64);
        Some(captured(origin_ns, local_ns, uncertainty_ns, self.source))
    }
}

const NS_PER_TICK: f64 = 1_000.0;

/// What is known of a clock that stamps frames, and answers when it is asked or never does.
#[derive(Clone, Debug)]
pub(crate) struct StampClock {
    pub(crate) echo: EchoClock,
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

    fn map(&self, stamp_us: u64) -> Option<CaptureTime> {
        let ((origin_us, origin_ns), least_ns, _) = self.known?;
        let elapsed_ns = difference(stamp_us, origin_us) * NS_PER_TICK;
        let local_ns = elapsed_ns + least_ns - self.assumed_ns as f64;
        let source = CaptureTimeSource::FrameTimestamp;
        Some(captured(origin_ns, local_ns, self.assumed_ns, source))
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

    /// Learns from a frame, and returns when it was captured.
    pub(crate) fn capture(&mut self, stamp_us: u64, receive_ns: u64) -> Option<CaptureTime> {
        self.least.observe(stamp_us, receive_ns);
        let by_echo = self.echo.map(stamp_us);
        by_echo.or_else(|| self.least.map(stamp_us))
    }
}

/// `to - from` of two readings of a wrapping counter, as a number.
const fn difference(to: u64, from: u64) -> f64 {
    to.wrapping_sub(from).cast_signed() as f64
}
