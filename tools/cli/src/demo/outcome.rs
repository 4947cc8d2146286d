//! How a demo goes on, and how it ends.

use std::time::Duration;

use indicatif::ProgressBar;
use singletrack_figures::plot::because;
use singletrack_pilot::{Mode, Reason};
use singletrack_sim::{TimedTruth, Truth};
use singletrackd::Summary;

use super::files::BoardFigures;
use crate::progress::progress_bar;

/// The bar of a drive of this duration, which is moved by milliseconds.
pub(super) fn bar(duration: Duration) -> ProgressBar {
    let length = u64::try_from(duration.as_millis()).unwrap_or(u64::MAX);
    progress_bar(length, "{bar:10} {percent:>3} %  {msg}")
}

pub(super) struct Progress {
    pub(super) bar: ProgressBar,
    expected_m: f64,
}

impl Progress {
    /// For a drive of this duration, whose error is expected to settle at a value.
    pub(super) fn new(duration: Duration, expected_m: f64) -> Self {
        Self {
            bar: bar(duration),
            expected_m,
        }
    }

    pub(super) fn waiting(&self, mode: Mode, reason: Option<Reason>) {
        self.bar.set_message(match reason {
            Some(reason) => format!("{mode}: waiting, {reason}"),
            None => mode.to_string(),
        });
    }

    pub(super) fn driving(&mut self, time: f64, truth: &Truth, error_m: f64, held: bool) {
        self.bar.set_position((time * 1000.0) as u64);
        self.bar.set_message(format!(
            // 80 columns wide, with the bar.
            "{time:4.1} s  car at ({:5.2}, {:5.2}) m, P {:5.1} mm off (theory: {:.0}){}",
            truth.x,
            truth.y,
            error_m * 1000.0,
            self.expected_m * 1000.0,
            if held { "  (markers lost)" } else { "" }
        ));
    }
}

/// A finished drive, for the report.
#[derive(Debug)]
pub(super) struct Drive {
    /// How it ended before its time, if it did.
    pub(super) ended: Option<Ended>,
    /// CLOCK_MONOTONIC, or virtual time, of the first driving tick, in ns.
    pub(super) start_ns: u64,
    /// How long the car drove, in s.
    pub(super) duration_s: f64,
    /// From the car's centre of mass to its front axle, in m.
    pub(super) front_axle_distance_m: f64,
    /// Where the car truly was.
    pub(super) truth: Vec<TimedTruth>,
    /// What the daemon counted in real time.
    pub(super) summary: Option<Summary>,
    /// What the image took of its processor.
    pub(super) board: Option<BoardFigures>,
}

/// A drive that ended before its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ended {
    pub(super) mode: Mode,
    pub(super) reason: Option<Reason>,
    pub(super) after_s: f64,
}

/// The car was never ready, or did not start.
#[derive(Debug, thiserror::Error)]
#[error("the car did not start within {seconds} s: mode {mode}{}", because(*reason))]
pub(super) struct NotStarted {
    /// The mode that it stayed in.
    pub(super) mode: Mode,
    /// Why.
    pub(super) reason: Option<Reason>,
    /// How long it was given.
    pub(super) seconds: u64,
}

/// Why a demo ended that somebody interrupted.
pub(super) const INTERRUPTED: &str = "interrupted";
