//! How a demo's drive went.

use singletrack_pilot::{Mode, Reason};
use singletrack_sim::TimedTruth;
use singletrackd::Summary;

use super::board_figures::BoardFigures;

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
