//! What an outer loop is: from P and its reference to the velocity of P, once per tick.

use crate::{Position, ReferencePoint, Velocity};

/// What an outer loop is given at a tick.
#[derive(Clone, Copy)]
pub struct TrackingInput<'a> {
    /// The position of P, in m.
    pub point: Position,
    /// The reference, by the time from now in s: at 0, and ahead for a loop that looks ahead.
    pub reference: &'a dyn Fn(f64) -> ReferencePoint,
    /// The velocity that P was given in the last tick, after every limit (m/s). It differs from
    /// the loop's own answer where something limited it, and the loop must not wind up then.
    pub applied: Velocity,
    /// The time until the next tick, in s.
    pub period: f64,
}

/// A controller of two integrators: it moves P to its reference.
///
/// It has a state, allocates nothing, and the same inputs give the same bits.
pub trait OuterLoop {
    /// One tick: the commanded velocity of P, in m/s.
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity;

    /// Forgets the past: the car stands, and a drive begins.
    fn reset(&mut self);
}
