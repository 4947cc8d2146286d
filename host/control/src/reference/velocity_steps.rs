//! Piecewise constant velocities: the paper's open-loop test.

use heapless::Vec;

use super::{ReferenceError, ReferencePoint, finite, positive};
use crate::Velocity;

/// The largest number of steps in a sequence.
pub const MAX_VELOCITY_STEPS: usize = 64;

/// One constant velocity of P.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityStep {
    /// Its duration, in s.
    pub duration: f64,
    /// The velocity, in m/s.
    pub velocity: Velocity,
}

/// Steps switch this much early, in s: a sum of durations that equals the time of a tick
/// up to rounding then switches at that tick.
const ROUNDING: f64 = 1e-9;

/// A sequence of constant velocities; the last one has no end.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocitySteps {
    /// The end of each step, in s, with its velocity.
    steps: Vec<(f64, Velocity), MAX_VELOCITY_STEPS>,
}

impl VelocitySteps {
    /// The sequence of `steps`. A step starts when the sum of the earlier
    /// durations has passed.
    ///
    /// # Errors
    ///
    /// At least one step, at most [`MAX_VELOCITY_STEPS`]; durations above zero,
    /// velocities finite.
    pub fn new(steps: &[VelocityStep]) -> Result<Self, ReferenceError> {
        if steps.is_empty() {
            return Err(ReferenceError::TooFew {
                name: "steps",
                count: 0,
                least: 1,
            });
        }
        let mut end = 0.0;
        let mut sequence = Vec::new();
        for step in steps {
            end += positive("duration_s", step.duration)?;
            finite("v_x_m_s", step.velocity.x)?;
            finite("v_y_m_s", step.velocity.y)?;
            sequence
                .push((end, step.velocity))
                .map_err(|_| ReferenceError::TooMany {
                    name: "steps",
                    most: MAX_VELOCITY_STEPS,
                })?;
        }
        Ok(Self { steps: sequence })
    }

    /// The end of the last step, in s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.steps.last().map_or(0.0, |step| step.0)
    }

    /// The position at `time` (s) of an ideal integrator that starts at `start`: the
    /// nominal trajectory of P (equation 6).
    #[must_use]
    pub fn integrate(&self, start: crate::Position, time: f64) -> crate::Position {
        let mut position = start;
        let mut begin = 0.0;
        let last = self.steps.len().saturating_sub(1);
        for (index, (end, velocity)) in self.steps.iter().enumerate() {
            let until = if index == last { time } else { time.min(*end) };
            position += (until - begin).max(0.0) * velocity;
            begin = *end;
        }
        position
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        self.first(|end| time < end - ROUNDING)
    }

    pub(super) fn before(&self, time: f64) -> ReferencePoint {
        self.first(|end| time <= end + ROUNDING)
    }

    pub(super) fn next_switch(&self, time: f64) -> Option<f64> {
        self.steps
            .iter()
            .map(|step| step.0)
            .take(self.steps.len().saturating_sub(1))
            .find(|end| *end > time + ROUNDING)
    }

    /// The first step whose end satisfies a condition, or the last step.
    fn first(&self, condition: impl Fn(f64) -> bool) -> ReferencePoint {
        ReferencePoint {
            position: None,
            velocity: self
                .steps
                .iter()
                .find(|(end, _)| condition(*end))
                .or(self.steps.last())
                .map_or_else(Velocity::zeros, |step| step.1),
        }
    }
}
