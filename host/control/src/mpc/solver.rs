//! The optimal plan over a horizon, by ADMM with a Riccati recursion.
//!
//! The method of `TinyMPC` (Nguyen, Schoedel, Alavilli, Plancher, Manchester 2024): one copy of the
//! plan obeys the dynamics, another the bounds, and a price on their difference brings them
//! together. The first is a linear-quadratic problem whose gains never change, the second a
//! projection of each stage by itself. So an iteration has a fixed cost, and the number of
//! iterations is fixed too.

use libm::sqrt;
use nalgebra::{RowSVector, SMatrix, SVector};

use crate::{
    ConvexArea, Position, Velocity,
    outer_loop::kept_by_lag,
    riccati::{QuadraticRegulator, RiccatiError, product, symmetric},
};

/// A lag of first order, sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// The time constant, in s.
    time_constant: f64,
    /// What of the velocity is left after a step.
    kept: f64,
    /// The step, in s.
    step: f64,
}

impl Lag {
    pub(super) fn new(time_constant: f64, step: f64) -> Self {
        Self {
            time_constant,
            kept: kept_by_lag(time_constant, step),
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

/// How far the new plan is carried beyond the last one; between 1.5 and 1.8 it needs the
/// fewest iterations.
const OVER_RELAXATION: f64 = 1.6;

/// The weights of the squared errors at each stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Weights {
    pub(super) position: f64,
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
}

/// The part of a stage that is bounded: of the nominal motion, of a deviation from it, or of the
/// prices. The nominal motion is the reference, with the commands with which P would stay on it.
///
/// Acceleration in the stage (m/s²), command (m/s) and position (m) after it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Bounded {
    pub(super) acceleration: Velocity,
    pub(super) command: Velocity,
    pub(super) position: Velocity,
}

/// The penalties on the difference between the two plans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Penalties {
    pub(super) acceleration: f64,
    pub(super) command: f64,
    pub(super) position: f64,
}

/// Penalties that balance the two plans: over the cases of the test against clarabel, about
/// these need the fewest iterations.
fn penalties(weights: &Weights) -> Penalties {
    Penalties {
        acceleration: 10.0 * weights.acceleration,
        command: 10.0 * sqrt(weights.acceleration * weights.position),
        position: 10.0 * weights.position,
    }
}

/// The bounds of every stage.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) acceleration: f64,
    pub(super) speed: f64,
    pub(super) area: Option<ConvexArea>,
}

/// How far the two plans are apart, and how far the bounded one moved in the last iteration
/// (in m, m/s and m/s², whichever is largest).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Residual {
    pub(super) primal: f64,
    pub(super) dual: f64,
}

/// The solver of `H` stages with `N` states on each axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Solver<const N: usize, const H: usize> {
    axis: Axis<N>,
    penalties: Penalties,
    pub(super) bounds: Bounds,
    /// The cost of the last state.
    #[cfg(test)]
    pub(super) terminal: SMatrix<f64, N, N>,
    stages: [Stage<N>; H],
    /// The plan that obeys the bounds, by its deviations.
    bounded: [Bounded; H],
    /// The prices, each over its penalty.
    prices: [Bounded; H],
}

/// What the Riccati recursion gives for a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stage<const N: usize> {
    gain: RowSVector<f64, N>,
    /// 1/(R + B'PB), with P of the stage after.
    inverse: f64,
}

impl<const N: usize, const H: usize> Solver<N, H> {
    pub(super) fn new(
        axis: Axis<N>,
        weights: Weights,
        bounds: Bounds,
    ) -> Result<Self, RiccatiError> {
        let penalties = penalties(&weights);
        let mut state_weight = SMatrix::<f64, N, N>::zeros();
        state_weight[(POSITION, POSITION)] = weights.position;
        state_weight[(VELOCITY, VELOCITY)] = weights.velocity;
        // Beyond the horizon the plan goes on without bounds, at the least cost.
        let terminal = QuadraticRegulator {
            transition: axis.transition,
            input: axis.input,
            state_weight,
            input_weight: nalgebra::Matrix1::new(weights.acceleration),
        }
        .solve()?
        .cost;
        let mut penalty = SMatrix::<f64, N, N>::zeros();
        penalty[(POSITION, POSITION)] = penalties.position;
        penalty[(COMMAND, COMMAND)] = penalties.command;

        let mut stages = [Stage {
            gain: RowSVector::zeros(),
            inverse: 0.0,
        }; H];
        let mut cost = terminal + penalty;
        for stage in stages.iter_mut().rev() {
            let onto = product(&cost, &axis.input);
            let input_weight = weights.acceleration + penalties.acceleration;
            let inverse = 1.0 / (input_weight + product(&axis.input.transpose(), &onto)[0]);
            let gain = inverse * product(&onto.transpose(), &axis.transition);
            let closed = SMatrix::<f64, N, N>::from_fn(|row, column| {
                axis.transition[(row, column)] - axis.input[row] * gain[column]
            });
            *stage = Stage { gain, inverse };
            let kept = product(&axis.transition.transpose(), &product(&cost, &closed));
            cost = symmetric(&(kept + state_weight + penalty));
        }
        Ok(Self {
            axis,
            penalties,
            bounds,
            #[cfg(test)]
            terminal,
            stages,
            bounded: [Bounded::default(); H],
            prices: [Bounded::default(); H],
        })
    }

    /// Forgets the last plan.
    pub(super) fn reset(&mut self) {
        self.bounded = [Bounded::default(); H];
        self.prices = [Bounded::default(); H];
    }

    /// Begins from the last plan without its first stage, which has passed.
    pub(super) fn shift(&mut self) {
        self.bounded.copy_within(1.., 0);
        self.prices.copy_within(1.., 0);
    }

    /// The plan that obeys the bounds, by its deviations from the nominal motion.
    pub(super) const fn plan(&self) -> &[Bounded; H] {
        &self.bounded
    }

    /// Iterates from the last plan towards the optimal one. `start` is the deviation
    /// of the state now.
    pub(super) fn solve(
        &mut self,
        start: &[Velocity; N],
        nominal: &[Bounded; H],
        iterations: usize,
    ) -> Residual {
        let mut residual = Residual::default();
        for _ in 0..iterations {
            residual = self.iterate(start, nominal);
        }
        residual
    }

    fn iterate(&mut self, start: &[Velocity; N], nominal: &[Bounded; H]) -> Residual {
        let feed = self.backward();
        let mut residual = Residual::default();
        let mut state = *start;
        for index in 0..H {
            let stage = &self.stages[index];
            let acceleration =
                (0..N).fold(-feed[index], |sum, row| sum - stage.gain[row] * state[row]);
            state = self.advance(&state, &acceleration);
            let free = Bounded {
                acceleration,
                command: state[COMMAND],
                position: state[POSITION],
            };
            let step = self.project(index, &free, &nominal[index]);
            residual.primal = residual.primal.max(step.primal);
            residual.dual = residual.dual.max(step.dual);
        }
        residual
    }

    /// The constant part of each stage's acceleration, from the last stage to the first.
    fn backward(&self) -> [Velocity; H] {
        let mut feed = [Velocity::zeros(); H];
        let mut linear = [Velocity::zeros(); N];
        for index in (0..H).rev() {
            let stage = &self.stages[index];
            let (bounded, price) = (&self.bounded[index], &self.prices[index]);
            let penalties = &self.penalties;
            linear[POSITION] -= penalties.position * (bounded.position - price.position);
            linear[COMMAND] -= penalties.command * (bounded.command - price.command);
            let of_input = (0..N).fold(
                -penalties.acceleration * (bounded.acceleration - price.acceleration),
                |sum, row| sum + self.axis.input[row] * linear[row],
            );
            feed[index] = stage.inverse * of_input;
            if index == 0 {
                break;
            }
            linear = core::array::from_fn(|column| {
                (0..N).fold(-stage.gain[column] * of_input, |sum, row| {
                    sum + self.axis.transition[(row, column)] * linear[row]
                })
            });
        }
        feed
    }

    fn advance(&self, state: &[Velocity; N], acceleration: &Velocity) -> [Velocity; N] {
        core::array::from_fn(|row| {
            (0..N).fold(self.axis.input[row] * acceleration, |sum, column| {
                sum + self.axis.transition[(row, column)] * state[column]
            })
        })
    }

    /// Moves a stage of the bounded plan, and its price, towards the `free` one.
    fn project(&mut self, index: usize, free: &Bounded, nominal: &Bounded) -> Residual {
        let was = self.bounded[index];
        let price = &mut self.prices[index];
        let carried = |free: &Velocity, was: &Velocity| {
            OVER_RELAXATION * free + (1.0 - OVER_RELAXATION) * was
        };
        let acceleration = carried(&free.acceleration, &was.acceleration) + price.acceleration;
        let command = carried(&free.command, &was.command) + price.command;
        let position = carried(&free.position, &was.position) + price.position;
        let within = |deviation: &Velocity, nominal: &Velocity, most: f64| {
            shorten(&(deviation + nominal), most) - nominal
        };
        let bounded = Bounded {
            acceleration: within(
                &acceleration,
                &nominal.acceleration,
                self.bounds.acceleration,
            ),
            command: within(&command, &nominal.command, self.bounds.speed),
            position: match &self.bounds.area {
                Some(area) => {
                    let place = Position::from(position + nominal.position);
                    area.nearest(&place).coords - nominal.position
                }
                None => position,
            },
        };
        *price = Bounded {
            acceleration: acceleration - bounded.acceleration,
            command: command - bounded.command,
            position: position - bounded.position,
        };
        self.bounded[index] = bounded;
        let largest = |one: &Bounded, other: &Bounded| {
            (one.acceleration - other.acceleration)
                .amax()
                .max((one.command - other.command).amax())
                .max((one.position - other.position).amax())
        };
        Residual {
            primal: largest(free, &bounded),
            dual: largest(&was, &bounded),
        }
    }
}

/// The vector, no longer than `most`.
pub(super) fn shorten(vector: &Velocity, most: f64) -> Velocity {
    let squared = vector.norm_squared();
    if squared <= most * most {
        return *vector;
    }
    // Rounding must not leave it longer.
    let shortened = vector * (most / sqrt(squared));
    if shortened.norm_squared() <= most * most {
        shortened
    } else {
        shortened * (1.0 - f64::EPSILON)
    }
}
