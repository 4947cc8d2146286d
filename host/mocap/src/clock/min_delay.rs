//! Without echoes: the least delay seen between the server's stamp and the arrival
//! of the frame, less an assumed delay, relates the two clocks.

use super::ticks::{Mapped, difference, offset_by};

/// The least delay is taken over the current window and the one before it: long
/// enough to catch a quick frame, short enough that the clocks do not drift apart.
const WINDOW_NS: u64 = 1_000_000_000;

#[derive(Clone, Debug)]
pub(crate) struct MinDelay {
    ns_per_tick: f64,
    max_skew: f64,
    assumed_delay_ns: u64,
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
    pub(crate) const fn new(ns_per_tick: f64, max_skew: f64, assumed_delay_ns: u64) -> Self {
        Self {
            ns_per_tick,
            max_skew,
            assumed_delay_ns,
            windows: None,
        }
    }

    /// Takes a stamp of the server and its time of arrival.
    pub(crate) fn observe(&mut self, ticks: u64, receive_ns: u64) {
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
            windows.previous_ns = if age_ns < 2 * WINDOW_NS {
                windows.current_ns
            } else {
                f64::INFINITY
            };
            windows.current_ns = delay_ns;
            windows.began_ns = receive_ns;
        } else {
            windows.current_ns = windows.current_ns.min(delay_ns);
        }
    }

    /// The local time at which the server's clock showed these ticks.
    pub(crate) fn map(&self, ticks: u64) -> Option<Mapped> {
        let windows = self.windows?;
        let (origin_ticks, origin_ns) = windows.origin;
        let elapsed_ns = difference(ticks, origin_ticks) * self.ns_per_tick;
        let least_ns = windows.current_ns.min(windows.previous_ns);
        let local_ns = elapsed_ns + least_ns - self.assumed_delay_ns as f64;
        let drift_ns = self.max_skew * (2 * WINDOW_NS) as f64;
        Some(Mapped {
            local_ns: offset_by(origin_ns, local_ns),
            uncertainty_ns: self.assumed_delay_ns.saturating_add(drift_ns as u64),
        })
    }
}
