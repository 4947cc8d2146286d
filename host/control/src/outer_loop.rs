//! The outer loop: the velocity of P that follows the reference.
//!
//! The linearised system is two integrators, so any linear controller is suitable; the
//! paper uses a proportional one.

use crate::{
    Position, ReferencePoint, Velocity,
    tracking::{OuterLoop, TrackingInput},
};

/// The paper's proportional position loop, with optional feed-forward of the reference's
/// velocity. A reference without a position is passed on unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProportionalLoop {
    /// `K_Px` and `K_Py`, per second.
    pub gain: Velocity,
    /// Adds the reference's velocity to the command. The acceleration is the caller's: it
    /// gives the reference of the moment at which the command acts, and leads the speed by
    /// the motor's lag.
    ///
    /// Without it, on a circle of angular velocity ω, the radius of P is 1/√(1 + (ω/K)²) of
    /// the reference's, and P lags by atan(ω/K).
    pub feed_forward: bool,
}

impl ProportionalLoop {
    /// The commanded velocity of P (m/s) when P is at `point` (m).
    #[must_use]
    pub fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Velocity {
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

/// No feedback: the velocity of the reference is the command (the paper's test of the law).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OpenLoop;

impl OpenLoop {
    /// The commanded velocity of P (m/s) when P is at `point` (m).
    #[must_use]
    pub fn velocity(&self, reference: &ReferencePoint, _point: &Position) -> Velocity {
        reference.velocity
    }
}

/// The outer loop that the configuration selects.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum TrackingLoop {
    /// See [`ProportionalLoop`].
    Proportional(ProportionalLoop),
    /// See [`OpenLoop`].
    OpenLoop(OpenLoop),
}

impl TrackingLoop {
    /// The commanded velocity of P (m/s) when P is at `point` (m).
    #[must_use]
    pub fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Velocity {
        match self {
            Self::Proportional(tracking) => tracking.velocity(reference, point),
            Self::OpenLoop(tracking) => tracking.velocity(reference, point),
        }
    }
}

/// Without a state: the present alone decides.
macro_rules! stateless {
    ($($kind:ty),*) => {$(
        impl OuterLoop for $kind {
            fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
                self.velocity(&(input.reference)(0.0), &input.point)
            }

            fn reset(&mut self) {}
        }
    )*};
}

stateless!(ProportionalLoop, OpenLoop, TrackingLoop);
