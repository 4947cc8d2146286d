//! The choice between the outer loops.

use crate::{
    DelayedMpc, LqiLoop, OpenLoop, Position, ProportionalLoop, ReferencePoint, Velocity,
    outer_loop::{OuterLoop, TrackingInput},
};

/// The outer loop that the configuration selects.
///
/// To [assign](Self::assign) one of the same kind allocates nothing.
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
    /// See [`BoxedLoop`](crate::BoxedLoop).
    #[cfg(feature = "alloc")]
    Own(crate::BoxedLoop),
}

impl TrackingLoop {
    /// Becomes a copy of `source`.
    pub fn assign(&mut self, source: &Self) {
        match (self, source) {
            #[cfg(feature = "alloc")]
            (Self::Own(tracking), Self::Own(source)) => tracking.clone_from(source),
            (tracking, source) => *tracking = source.clone(),
        }
    }

    /// The commanded velocity of P (m/s) when P is at `point` (m); none for a loop with a state,
    /// which needs a tick.
    pub fn velocity(&self, reference: &ReferencePoint, point: &Position) -> Option<Velocity> {
        match self {
            Self::Proportional(tracking) => Some(tracking.velocity(reference, point)),
            Self::OpenLoop(tracking) => Some(tracking.velocity(reference, point)),
            _ => None,
        }
    }

    /// The proportional gains, per second; none for a loop without such gains.
    pub const fn gain(&self) -> Option<Velocity> {
        match self {
            Self::Proportional(tracking) => Some(tracking.gain),
            _ => None,
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
            #[cfg(feature = "alloc")]
            Self::Own(tracking) => tracking,
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

    fn plans(&self) -> bool {
        match self {
            Self::Mpc(tracking) => tracking.plans(),
            #[cfg(feature = "alloc")]
            Self::Own(tracking) => tracking.plans(),
            _ => false,
        }
    }
}
