//! What the predictive controller believes of P: a delay, a lag and an integrator.

use libm::exp;
use nalgebra::{SMatrix, SVector};

use crate::Velocity;

/// A lag of first order, sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// The time constant, in s.
    pub(super) time_constant: f64,
    /// What of the velocity is left after a step.
    kept: f64,
    /// The step, in s.
    step: f64,
}

impl Lag {
    pub(super) fn new(time_constant: f64, step: f64) -> Self {
        let kept = if time_constant > 0.0 {
            exp(-step / time_constant)
        } else {
            0.0
        };
        Self {
            time_constant,
            kept,
            step,
        }
    }

    /// The velocity after a step, and the way in it, with the same command throughout.
    pub(super) fn hold(&self, velocity: &Velocity, command: &Velocity) -> (Velocity, Velocity) {
        let after = self.kept * velocity + (1.0 - self.kept) * command;
        let way = self.step * command + self.time_constant * (velocity - after);
        (after, way)
    }

    /// How the velocity after a step depends on the velocity before it, and on the command at
    /// the begin and at the end, between which it changes evenly.
    fn ramp(&self) -> [f64; 3] {
        let settled = 1.0 - self.kept;
        let end = 1.0 - self.time_constant / self.step * settled;
        [self.kept, settled - end, end]
    }
}

/// One axis of P over a stage: the state is position, velocity, command, and the commands of
/// the `N - 3` stages before; the input is the acceleration of the command.
///
/// The axes are alike and independent, and what couples them are the bounds alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axis<const N: usize> {
    pub(super) transition: SMatrix<f64, N, N>,
    pub(super) input: SVector<f64, N>,
}

/// Index of the position in the state.
pub(super) const POSITION: usize = 0;
/// Index of the velocity.
pub(super) const VELOCITY: usize = 1;
/// Index of the command; those of the stages before follow it.
pub(super) const COMMAND: usize = 2;

impl<const N: usize> Axis<N> {
    pub(super) fn new(time_constant: f64, stage: f64) -> Self {
        const { assert!(N >= 3, "position, velocity and command are three") };
        let lag = Lag::new(time_constant, stage);
        let after = |state: &SVector<f64, N>, acceleration: f64| {
            let command = state[COMMAND] + stage * acceleration;
            // The command that the car obeys at the begin of the stage, and at its end.
            let begin = state[N - 1];
            let end = if N == 3 { command } else { state[N - 2] };
            let [kept, of_begin, of_end] = lag.ramp();
            let velocity = kept * state[VELOCITY] + of_begin * begin + of_end * end;
            let mut next = SVector::zeros();
            next[POSITION] = state[POSITION]
                + 0.5 * stage * (begin + end)
                + time_constant * (state[VELOCITY] - velocity);
            next[VELOCITY] = velocity;
            next[COMMAND] = command;
            for older in COMMAND + 1..N {
                next[older] = state[older - 1];
            }
            next
        };
        let mut transition = SMatrix::<f64, N, N>::zeros();
        for index in 0..N {
            let mut unit = SVector::zeros();
            unit[index] = 1.0;
            transition.set_column(index, &after(&unit, 0.0));
        }
        Self {
            transition,
            input: after(&SVector::zeros(), 1.0),
        }
    }
}
