//! Echo exchanges: each proves that the server's clock showed some ticks at a
//! local time between sending the request and receiving the answer.
//!
//! How the round trip divides into the way there and the way back is not assumed:
//! an exchange bounds the local time to plus or minus half of the round trip. Moved
//! along by the clocks' rates, all bounds hold at once, so their intersection holds
//! too. Its middle is the estimate, and half its width is the uncertainty.

use super::ticks::{Mapped, difference, offset_by};

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
        let backward = self
            .samples
            .back()
            .is_some_and(|newest| difference(sample.server_ticks, newest.server_ticks) < 0.0);
        if backward {
            return SampleUse::Backward;
        }
        let contradicts = self
            .estimate(sample.server_ticks, sample.sent_ns)
            .is_some_and(|predicted| {
                let measured = self.bound(&sample, sample.server_ticks, sample.sent_ns);
                libm::fabs(predicted.middle - measured.middle)
                    > predicted.half_width + measured.half_width
            });
        if contradicts {
            self.samples.clear();
        }
        if self.samples.is_full() {
            self.samples.pop_front();
        }
        // Room was made above.
        let _ = self.samples.push_back(sample);
        self.fit_skew();
        if contradicts {
            SampleUse::Stepped
        } else {
            SampleUse::Agreed
        }
    }

    /// The local time at which the server's clock shows these ticks.
    pub(crate) fn map(&self, server_ticks: u64) -> Option<Mapped> {
        let origin_ns = self.samples.back()?.received_ns;
        let bound = self.estimate(server_ticks, origin_ns)?;
        Some(Mapped {
            local_ns: offset_by(origin_ns, bound.middle),
            uncertainty_ns: libm::ceil(bound.half_width) as u64,
        })
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
