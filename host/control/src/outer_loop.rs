//! From where P should be to how fast it should move.
//!
//! The linearised system is two integrators, so any linear controller fits
//! here; the paper uses a proportional one.

use crate::{Position, ReferencePoint, Velocity};

/// A controller for two independent integrators.
pub trait OuterLoop {
    /// The velocity wanted of P (m/s), at P's position `point` (m).
    fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Velocity;
}

/// The paper's proportional position loop, with the reference's velocity fed
/// forward if asked. A reference without a position passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProportionalLoop {
    /// `K_Px` and `K_Py`, per second.
    pub gain: Velocity,
    /// Whether the reference's velocity is added.
    ///
    /// Without it P follows a circle of angular velocity ω on an amplitude
    /// 1/√(1 + (ω/K)²) of the reference's, atan(ω/K) behind.
    pub feed_forward: bool,
}

impl OuterLoop for ProportionalLoop {
    fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Velocity {
        match reference.position {
            None => reference.velocity,
            Some(position) => {
                let correction = self.gain.component_mul(&(position - point));
                if self.feed_forward {
                    correction + reference.velocity
                } else {
                    correction
                }
            }
        }
    }
}

/// No feedback: the reference's velocity alone (the paper's test of the law).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OpenLoop;

impl OuterLoop for OpenLoop {
    fn velocity(&self, reference: &ReferencePoint, _point: &Position) -> Velocity {
        reference.velocity
    }
}

/// An outer loop chosen by configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrackingLoop {
    /// See [`ProportionalLoop`].
    Proportional(ProportionalLoop),
    /// See [`OpenLoop`].
    OpenLoop(OpenLoop),
}

impl OuterLoop for TrackingLoop {
    fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Velocity {
        match self {
            Self::Proportional(tracking) => tracking.velocity(reference, point),
            Self::OpenLoop(tracking) => tracking.velocity(reference, point),
        }
    }
}
