//! The predictive loop of a dead time that is not known before the configuration is read.

use libm::rint;

use super::{MpcConfig, MpcError, MpcLoop, MpcVerdict};
use crate::{
    Velocity,
    tracking::{OuterLoop, TrackingInput},
};

/// The stages of the plan of a [`DelayedMpc`].
pub const MPC_STAGES: usize = 25;

/// [`MpcLoop`] with a model for a dead time, or without one.
#[expect(
    clippy::large_enum_variant,
    reason = "without an allocator they can't be boxed"
)]
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum DelayedMpc {
    /// A command acts at once.
    Prompt(MpcLoop<3, MPC_STAGES>),
    /// A command acts a stage later.
    Late(MpcLoop<4, MPC_STAGES>),
}

impl DelayedMpc {
    /// The loop for commands that act `dead_time` (s) later. A stage of the plan is as long as
    /// the dead time then; one below half a stage of `config` counts as a part of the lag.
    ///
    /// # Errors
    ///
    /// See [`MpcError`].
    pub fn new(config: MpcConfig, dead_time: f64) -> Result<Self, MpcError> {
        let stage = config.period * config.ticks_per_stage as f64;
        if dead_time < 0.5 * stage {
            return MpcLoop::new(MpcConfig {
                lag: config.lag + dead_time,
                ..config
            })
            .map(Self::Prompt);
        }
        let ticks_per_stage = rint(dead_time / config.period).max(1.0) as usize;
        MpcLoop::new(MpcConfig {
            ticks_per_stage,
            ..config
        })
        .map(Self::Late)
    }

    /// What the last tick came to.
    #[must_use]
    pub const fn verdict(&self) -> MpcVerdict {
        match self {
            Self::Prompt(tracking) => tracking.verdict(),
            Self::Late(tracking) => tracking.verdict(),
        }
    }
}

impl OuterLoop for DelayedMpc {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        match self {
            Self::Prompt(tracking) => tracking.step(input),
            Self::Late(tracking) => tracking.step(input),
        }
    }

    fn reset(&mut self) {
        match self {
            Self::Prompt(tracking) => tracking.reset(),
            Self::Late(tracking) => tracking.reset(),
        }
    }
}
