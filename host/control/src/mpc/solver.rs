//! The optimal plan over a horizon, by ADMM with a Riccati recursion.
//!
//! As `TinyMPC` does it (Nguyen, Schoedel, Alavilli, Plancher, Manchester 2024): one copy of the
//! plan obeys the dynamics, another the bounds, and a price on their difference brings them
//! together. The first is a linear-quadratic problem whose gains never change, the second a
//! projection of each stage by itself. So an iteration has a fixed cost, and the number of
//! iterations is fixed too.

use nalgebra::SMatrix;

use super::model::{Axis, COMMAND, POSITION, VELOCITY};
use crate::{
    ConvexArea, Position, Velocity,
    riccati::{QuadraticRegulator, RiccatiError},
};

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
    gain: [f64; N],
    /// 1/(R + B'PB), with P of the stage after.
    inverse: f64,
}

impl<const N: usize, const H: usize> Solver<N, H> {
    pub(super) fn new(
        axis: Axis<N>,
        weights: Weights,
        penalties: Penalties,
        bounds: Bounds,
    ) -> Result<Self, RiccatiError> {
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
            gain: [0.0; N],
            inverse: 0.0,
        }; H];
        let mut cost = terminal + penalty;
        for stage in stages.iter_mut().rev() {
            let onto = times(&cost, &axis.input);
            let input_weight = weights.acceleration + penalties.acceleration;
            let inverse = 1.0 / (input_weight + dot(&axis.input.into(), &onto));
            let gain: [f64; N] = core::array::from_fn(|column| {
                inverse * dot(&onto, &axis.transition.column(column).into_owned().into())
            });
            let closed = SMatrix::<f64, N, N>::from_fn(|row, column| {
                axis.transition[(row, column)] - axis.input[row] * gain[column]
            });
            *stage = Stage { gain, inverse };
            let kept = SMatrix::<f64, N, N>::from_fn(|row, column| {
                let after = times(&cost, &closed.column(column).into_owned());
                dot(&axis.transition.column(row).into_owned().into(), &after)
            });
            cost = kept + state_weight + penalty;
            cost = 0.5 * (cost + cost.transpose());
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
    pub(super) const fn reset(&mut self) {
        let nothing = Bounded {
            acceleration: Velocity::new(0.0, 0.0),
            command: Velocity::new(0.0, 0.0),
            position: Velocity::new(0.0, 0.0),
        };
        self.bounded = [nothing; H];
        self.prices = [nothing; H];
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
    let shortened = vector * (most / libm::sqrt(squared));
    if shortened.norm_squared() <= most * most {
        shortened
    } else {
        shortened * (1.0 - f64::EPSILON)
    }
}

fn dot<const N: usize>(one: &[f64; N], other: &[f64; N]) -> f64 {
    (0..N).fold(0.0, |sum, index| sum + one[index] * other[index])
}

fn times<const N: usize>(
    matrix: &SMatrix<f64, N, N>,
    vector: &nalgebra::SVector<f64, N>,
) -> [f64; N] {
    core::array::from_fn(|row| {
        (0..N).fold(0.0, |sum, column| {
            sum + matrix[(row, column)] * vector[column]
        })
    })
}
