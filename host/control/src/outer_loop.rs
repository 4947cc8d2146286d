//! The outer loop: the velocity of P that follows the reference.
//!
//! The linearised system is two integrators, so any linear controller is suitable; the
//! paper uses a proportional one.

use crate::{
    DelayedMpc, LqiLoop, Position, ReferencePoint, Velocity,
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

stateless!(ProportionalLoop, OpenLoop);

/// The outer loop that the configuration selects.
#[expect(
    clippy::large_enum_variant,
    reason = "a controller has one or two of them, and without an allocator it can't be boxed"
)]
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum TrackingLoop {
    /// See [`ProportionalLoop`].
    Proportional(ProportionalLoop),
    /// See [`LqiLoop`].
    Lqi(LqiLoop),
    /// See [`MpcLoop`](crate::MpcLoop).
    Mpc(DelayedMpc),
    /// See [`OpenLoop`].
    OpenLoop(OpenLoop),
}

impl TrackingLoop {
    /// The commanded velocity of P (m/s) when P is at `point` (m); none for a loop with a state,
    /// which needs a tick.
    #[must_use]
    pub fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Option<Velocity> {
        match self {
            Self::Proportional(tracking) => Some(tracking.velocity(reference, point)),
            Self::OpenLoop(tracking) => Some(tracking.velocity(reference, point)),
            Self::Lqi(_) | Self::Mpc(_) => None,
        }
    }

    /// The proportional gains, per second; none for a loop without such gains.
    #[must_use]
    pub const fn gain(&self) -> Option<Velocity> {
        match self {
            Self::Proportional(tracking) => Some(tracking.gain),
            Self::Lqi(_) | Self::Mpc(_) | Self::OpenLoop(_) => None,
        }
    }

    /// Replaces the proportional gains, per second; without effect on a loop that has none.
    pub const fn set_gain(&mut self, gain: Velocity) {
        if let Self::Proportional(tracking) = self {
            tracking.gain = gain;
        }
    }

    fn kind(&mut self) -> &mut dyn OuterLoop {
        match self {
            Self::Proportional(tracking) => tracking,
            Self::Lqi(tracking) => tracking,
            Self::Mpc(tracking) => tracking,
            Self::OpenLoop(tracking) => tracking,
        }
    }
}

impl OuterLoop for TrackingLoop {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        self.kind().step(input)
    }

    fn reset(&mut self) {
        self.kind().reset();
    }
}
