//! Other rigid bodies: obstacles of the drive.

use singletrack_control::{
    Estimate, Expected, NeighbourConfig, NeighbourSample, NeighbourSides, Neighbours, Time,
    Velocity,
};

use crate::supervisor::Reason;

/// A body that no frame lists for so long is forgotten before a drive, s.
const SILENCE: f64 = 1.0;

/// The car waits for so long after there was no way, s: it must not jerk.
const PAUSE: f64 = 0.5;

/// The other bodies, and how the car waits for them.
#[derive(Clone, Debug)]
pub(super) struct Obstacles {
    /// None if the car does not keep apart from them.
    neighbours: Option<Neighbours>,
    /// What keeps it apart in this tick.
    pub(super) sides: NeighbourSides,
    /// What it must not cross, even if they brake now.
    pub(super) last_sides: NeighbourSides,
    /// How long it still waits after there was no way, s.
    pause: f64,
    /// How long the car has stood before one of them, s.
    stood: f64,
}

impl Obstacles {
    pub(super) fn new(config: Option<&NeighbourConfig>) -> Self {
        Self {
            neighbours: config.map(|config| Neighbours::new(*config)),
            sides: NeighbourSides::new(),
            last_sides: NeighbourSides::new(),
            pause: 0.0,
            stood: 0.0,
        }
    }

    pub(super) fn handle(&mut self, sample: &NeighbourSample) {
        if let Some(neighbours) = &mut self.neighbours {
            neighbours.handle(sample);
        }
    }

    /// A drive begins.
    pub(super) const fn begin(&mut self) {
        (self.pause, self.stood) = (0.0, 0.0);
    }

    /// A tick begins, of a drive or outside one.
    pub(super) fn observe(&mut self, now: Time, estimate: Option<&Estimate>, drives: bool) {
        let Some(neighbours) = &mut self.neighbours else {
            return;
        };
        if !drives {
            neighbours.forget(now, SILENCE);
        }
        let sides = |expected| {
            estimate.map_or_else(NeighbourSides::new, |estimate| {
                neighbours.sides(now, &estimate.position, expected)
            })
        };
        (self.sides, self.last_sides) = (sides(Expected::Worst), sides(Expected::BrakesNow));
    }

    /// Whether one of them may be anywhere.
    pub(super) fn are_unknown(&self) -> bool {
        self.neighbours
            .as_ref()
            .is_some_and(Neighbours::are_unknown)
    }

    /// The share of a period by which the reference waits: what the filter has left out of the wanted
    /// velocity of P (m/s).
    pub(super) fn delay(&self, wanted: &Velocity, given: &Velocity) -> f64 {
        if self.sides.is_empty() {
            return 0.0;
        }
        let share = given.dot(wanted) / wanted.norm_squared();
        // NaN, where nothing is wanted, delays nothing.
        (1.0 - share.clamp(0.0, 1.0)).max(0.0)
    }

    /// Whether the car stands for one of them: while they leave no way, and for a while after.
    pub(super) fn wait(&mut self, no_way: bool, period: f64) -> bool {
        self.pause = if no_way { PAUSE } else { self.pause - period };
        self.pause > 0.0
    }

    /// A tick in which the car stands before one of them, or not. Why the drive ends, if it has
    /// stood there for too long.
    pub(super) fn stand(&mut self, stands: bool, period: f64) -> Option<Reason> {
        let patience = self.neighbours.as_ref()?.config().patience;
        self.stood = if stands { self.stood + period } else { 0.0 };
        (self.stood > patience).then_some(Reason::NeighbourNear)
    }
}
