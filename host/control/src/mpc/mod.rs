//! The predictive outer loop: the best motion of P within bounds, over a horizon.

mod solver;

#[cfg(test)]
mod against_clarabel_tests;

use libm::{ceil, rint, sqrt};

use self::solver::{
    Axis, Bounded, Bounds, COMMAND, Lag, POSITION, Solver, VELOCITY, Weights, shorten,
};
use crate::{
    ConvexArea, Position, ReferencePoint, Velocity,
    outer_loop::{OuterLoop, TrackingInput, forward_of},
    riccati::RiccatiError,
};

/// The number of ticks whose commands are kept: the longest delay.
pub const MAX_DELAY_TICKS: usize = 63;
/// Two plans that differ by less count as one (m, m/s, m/s²).
const CONVERGED: f64 = 1e-3;
/// Plans that are so far apart (m, m/s, m/s²) come from NaN or infinity.
const ABSURD: f64 = 1e3;
/// The largest disturbance that is believed, as a share of the largest speed: a car that does
/// not move at all is no drift.
const LARGEST_DISTURBANCE: f64 = 0.25;

/// The settings of a [`MpcLoop`].
#[derive(Clone, Debug, PartialEq)]
pub struct MpcConfig {
    /// Time constant from the commanded velocity of P to its velocity, in s.
    pub lag: f64,
    /// The control period, in s.
    pub period: f64,
    /// How many periods a stage of the plan has, which is also one step of the delay.
    pub ticks_per_stage: usize,
    /// Weight of the distance from the reference, m⁻².
    pub position_weight: f64,
    /// Weight of the velocity's error, (m/s)⁻².
    pub velocity_weight: f64,
    /// Weight of the acceleration beyond the reference's, (m/s²)⁻².
    pub acceleration_weight: f64,
    /// The largest commanded speed of P, in m/s.
    pub max_speed: f64,
    /// The largest change of the commanded velocity of P, in m/s², in any direction.
    pub max_acceleration: f64,
    /// The deceleration with which P can stop, in m/s²; at most `max_acceleration`.
    pub max_deceleration: f64,
    /// Where P may be.
    pub area: Option<ConvexArea>,
    /// The number of iterations in every tick.
    pub iterations: usize,
    /// Which share of an unexplained velocity is believed at once: 0 is never, and a drift then
    /// stays as an error.
    pub disturbance_gain: f64,
}

/// Why a [`MpcConfig`] makes no controller.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MpcError {
    /// A value, by its name, must be finite and above zero.
    #[error("{0} is {1}: it must be finite and above zero")]
    NotPositive(&'static str, f64),
    /// A value, by its name, must be between 0 and 1.
    #[error("{0} is {1}: it must be between 0 and 1")]
    NotAShare(&'static str, f64),
    /// The delay is longer than the memory of past commands.
    #[error("a delay of {0} ticks is longer than {MAX_DELAY_TICKS}")]
    Delay(usize),
    /// The weights make no regulator.
    #[error(transparent)]
    Weights(#[from] RiccatiError),
}

/// What the last tick of a [`MpcLoop`] came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MpcVerdict {
    /// The plan has converged, and P can stop inside the area after its first step.
    #[default]
    Converged,
    /// The plan has not converged within its iterations; its first step obeys the bounds, and P
    /// can stop inside the area after it.
    Unconverged,
    /// After the plan's first step P could not stop inside the area: it slows down instead.
    Braked,
}

/// Model predictive control of P with `N - 3` stages of delay and a horizon of `H` stages.
///
/// The plan minimises the distance from the reference, within bounds on speed and acceleration
/// of the commanded velocity and on the place of P. The number of iterations is fixed, so a
/// tick always costs the same; what has not converged by then does not break a bound:
///
/// - The first step is taken from the plan that obeys the bounds on speed and acceleration.
/// - It is taken only if P, by the model, can stop inside the area after it. Otherwise P slows
///   down with the largest deceleration, as the tick before had proved to be possible.
#[derive(Clone, Debug, PartialEq)]
pub struct MpcLoop<const N: usize, const H: usize> {
    config: MpcConfig,
    /// The lag over a tick.
    lag: Lag,
    solver: Solver<N, H>,
    state: PlanState,
}

#[derive(Clone, Debug, PartialEq)]
struct PlanState {
    /// The commands that were applied, world frame; the last one first.
    applied: [Velocity; MAX_DELAY_TICKS + 1],
    /// How they deviate from the nominal ones, along and across the reference.
    deviations: [Velocity; MAX_DELAY_TICKS + 1],
    /// The deviation of the velocity of P by the model, along and across, in m/s. On a circle
    /// the commands to motor and servo are constant: the lag is in the frame that turns.
    deviation: Velocity,
    /// The velocity of P itself by the model, world frame, in m/s.
    velocity: Velocity,
    /// The nominal command of the tick before, world frame.
    nominal: Option<Velocity>,
    /// P (m) and the velocity of its reference (m/s) at the tick before.
    last: Option<(Position, Velocity)>,
    /// The velocity that the model does not explain, along and across, in m/s.
    disturbance: Velocity,
    /// The direction of the reference's velocity.
    forward: Velocity,
    /// Ticks since the plan was shifted.
    ticks: usize,
    verdict: MpcVerdict,
}

impl PlanState {
    const NEW: Self = Self {
        applied: [Velocity::new(0.0, 0.0); MAX_DELAY_TICKS + 1],
        deviations: [Velocity::new(0.0, 0.0); MAX_DELAY_TICKS + 1],
        deviation: Velocity::new(0.0, 0.0),
        velocity: Velocity::new(0.0, 0.0),
        nominal: None,
        last: None,
        disturbance: Velocity::new(0.0, 0.0),
        forward: Velocity::new(1.0, 0.0),
        ticks: 0,
        verdict: MpcVerdict::Converged,
    };
}

/// The vector with these components along and across `forward`.
fn out_of_frame(forward: &Velocity, vector: &Velocity) -> Velocity {
    vector.x * forward + vector.y * Velocity::new(-forward.y, forward.x)
}

/// The components of the vector along and across `forward`.
fn into_frame(forward: &Velocity, vector: &Velocity) -> Velocity {
    Velocity::new(forward.dot(vector), forward.perp(vector))
}

fn is_finite(vector: &Velocity) -> bool {
    vector.iter().all(|number| number.is_finite())
}

impl<const N: usize, const H: usize> MpcLoop<N, H> {
    /// Computes everything that stays the same.
    ///
    /// # Errors
    ///
    /// See [`MpcError`].
    pub fn new(config: MpcConfig) -> Result<Self, MpcError> {
        let numbers = [
            ("period", config.period),
            ("ticks_per_stage", config.ticks_per_stage as f64),
            ("position_weight", config.position_weight),
            ("acceleration_weight", config.acceleration_weight),
            ("max_speed", config.max_speed),
            ("max_acceleration", config.max_acceleration),
            ("max_deceleration", config.max_deceleration),
            ("iterations", config.iterations as f64),
            // Zero is a value for these.
            ("lag", config.lag + 1.0),
            ("velocity_weight", config.velocity_weight + 1.0),
        ];
        let least = |name| {
            if matches!(name, "lag" | "velocity_weight") {
                1.0
            } else {
                f64::MIN_POSITIVE
            }
        };
        let is_wrong = |&(name, value): &(_, f64)| !(value.is_finite() && value >= least(name));
        if let Some((name, value)) = numbers.into_iter().find(is_wrong) {
            return Err(MpcError::NotPositive(name, value));
        }
        let gain = config.disturbance_gain;
        if !(0.0..=1.0).contains(&gain) {
            return Err(MpcError::NotAShare("disturbance_gain", gain));
        }
        let config = MpcConfig {
            max_deceleration: config.max_deceleration.min(config.max_acceleration),
            ..config
        };
        let delay = (N - 3) * config.ticks_per_stage;
        if delay > MAX_DELAY_TICKS {
            return Err(MpcError::Delay(delay));
        }
        let stage = config.period * config.ticks_per_stage as f64;
        let weights = Weights {
            position: config.position_weight,
            velocity: config.velocity_weight,
            acceleration: config.acceleration_weight,
        };
        let solver = Solver::new(
            Axis::new(config.lag, stage),
            weights,
            Bounds {
                acceleration: config.max_acceleration,
                speed: config.max_speed,
                area: config.area.clone(),
            },
        )?;
        Ok(Self {
            lag: Lag::new(config.lag, config.period),
            solver,
            state: PlanState::NEW,
            config,
        })
    }

    /// What the last tick came to.
    pub const fn verdict(&self) -> MpcVerdict {
        self.state.verdict
    }

    /// The delay, in ticks.
    const fn delay(&self) -> usize {
        (N - 3) * self.config.ticks_per_stage
    }

    /// How long after a command the velocity of P follows it, to first order, in s.
    fn latency(&self) -> f64 {
        self.config.period * self.delay() as f64 + self.config.lag
    }

    /// The command with which P would keep to the reference: its speed as it will be when the
    /// command acts, in its present direction `forward`, because the law turns with the car.
    fn nominal(&self, ahead: &ReferencePoint, forward: &Velocity) -> Velocity {
        let speed = sqrt(ahead.velocity.norm_squared());
        // Neither NaN nor a speed that nothing has.
        let speed = if speed.is_finite() { speed } else { 0.0 };
        let along = Velocity::new(speed.min(self.config.max_speed), 0.0);
        out_of_frame(forward, &(along - self.state.disturbance))
    }

    /// Takes the last tick's command and the present place of P into the model.
    fn observe(&mut self, input: &TrackingInput<'_>, reference: &ReferencePoint) {
        let delay = self.delay();
        let applied = if is_finite(&input.applied) {
            input.applied
        } else {
            Velocity::zeros()
        };
        let state = &mut self.state;
        state.applied.copy_within(..MAX_DELAY_TICKS, 1);
        state.applied[0] = applied;
        state.deviations.copy_within(..MAX_DELAY_TICKS, 1);
        let deviation = state
            .nominal
            .map_or(Velocity::zeros(), |nominal| applied - nominal);
        state.deviations[0] = into_frame(&state.forward, &deviation);
        state.velocity = self.lag.hold(&state.velocity, &state.applied[delay]).0;
        let (deviation, way) = self.lag.hold(&state.deviation, &state.deviations[delay]);
        if is_finite(&deviation) {
            state.deviation = deviation;
        }
        if let Some((point, velocity)) = state.last {
            // The way that the reference makes, whatever its position does.
            let way = 0.5 * self.config.period * (velocity + reference.velocity)
                + out_of_frame(&state.forward, &way);
            let unexplained = (input.point - point - way) / self.config.period;
            let change = into_frame(&state.forward, &unexplained);
            let disturbance = state.disturbance + self.config.disturbance_gain * change;
            if is_finite(&disturbance) {
                let most = LARGEST_DISTURBANCE * self.config.max_speed;
                state.disturbance = shorten(&disturbance, most);
            }
        }
        state.last = (is_finite(&input.point.coords) && is_finite(&reference.velocity))
            .then_some((input.point, reference.velocity));
        state.forward = forward_of(&reference.velocity, &state.forward);
    }

    /// The nominal motion over the horizon. A command is in force from its tick on: what is
    /// commanded now is the command of one period after `last`, and so on.
    fn horizon(&self, reference: &dyn Fn(f64) -> ReferencePoint, last: &Velocity) -> [Bounded; H] {
        let stage = self.config.period * self.config.ticks_per_stage as f64;
        let mut forward = self.state.forward;
        let mut command = *last;
        core::array::from_fn(|index| {
            let end = (index + 1) as f64 * stage;
            let issued = end - self.config.period;
            forward = forward_of(&reference(issued).velocity, &forward);
            let next = self.nominal(&reference(issued + self.latency()), &forward);
            let acceleration = (next - command) / stage;
            command = next;
            Bounded {
                acceleration,
                command,
                position: reference(end).position.unwrap_or_default().coords,
            }
        })
    }

    /// Whether P stays in the area if it is commanded `first` now and slows down then; with the
    /// disturbance, which may be over soon, and without.
    fn stops_inside(&self, here: &Position, first: &Velocity) -> bool {
        let drift = out_of_frame(&self.state.forward, &self.state.disturbance);
        let drifts = [drift, Velocity::zeros()];
        drifts
            .iter()
            .all(|drift| self.stops_inside_with(here, first, drift))
    }

    fn stops_inside_with(&self, here: &Position, first: &Velocity, drift: &Velocity) -> bool {
        let Some(area) = &self.config.area else {
            return true;
        };
        let period = self.config.period;
        let slower = self.config.max_deceleration * period;
        let delay = self.delay();
        let speed = sqrt(first.norm_squared());
        // Until the command has gone through the delay at zero.
        let ticks = ceil(speed / slower) as usize + 1 + delay;
        let drift = drift * period;
        let mut position = *here;
        let mut velocity = self.state.velocity;
        for tick in 0..ticks {
            // What was commanded as many ticks before as the delay has.
            let command = match tick.checked_sub(delay) {
                None => self.state.applied[delay - 1 - tick],
                Some(since) => shorten(first, (speed - slower * since as f64).max(0.0)),
            };
            let (after, way) = self.lag.hold(&velocity, &command);
            velocity = after;
            position += way + drift;
            if area.clearance(&position) < 0.0 {
                return false;
            }
        }
        // The way that the rest of the velocity makes.
        area.clearance(&(position + self.config.lag * velocity)) >= 0.0
    }

    /// The command of this tick: `acceleration` from the last one, within the bounds, or
    /// slower than it.
    fn choose(&mut self, here: &Position, acceleration: &Velocity, converged: bool) -> Velocity {
        let now = self.state.applied[0];
        let change = self.config.max_acceleration * self.config.period;
        let step = shorten(&(acceleration * self.config.period), change);
        let wanted = shorten(&(now + step), self.config.max_speed);
        let finite = wanted.x.is_finite() && wanted.y.is_finite();
        if finite && self.stops_inside(here, &wanted) {
            self.state.verdict = if converged {
                MpcVerdict::Converged
            } else {
                MpcVerdict::Unconverged
            };
            wanted
        } else {
            self.brake()
        }
    }

    /// Slows down as much as the bounds allow. A plan that led here is no start for another one.
    fn brake(&mut self) -> Velocity {
        self.solver.reset();
        self.state.verdict = MpcVerdict::Braked;
        let now = self.state.applied[0];
        let change = self.config.max_deceleration * self.config.period;
        shorten(&now, (sqrt(now.norm_squared()) - change).max(0.0))
    }
}

impl<const N: usize, const H: usize> OuterLoop for MpcLoop<N, H> {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        let reference = (input.reference)(0.0);
        self.observe(input, &reference);
        let Some(wanted) = reference.position else {
            self.state.nominal = None;
            // Only a velocity is asked for: as far as the bounds allow it.
            let change = reference.velocity - self.state.applied[0];
            return self.choose(&input.point, &(change / self.config.period), true);
        };
        self.state.ticks += 1;
        if self.state.ticks >= self.config.ticks_per_stage {
            self.state.ticks = 0;
            self.solver.shift();
        }
        let stage = self.config.ticks_per_stage;
        let error = input.point - wanted;
        let ahead = (input.reference)(self.latency());
        let nominal = self.nominal(&ahead, &self.state.forward);
        let last = self.state.nominal.replace(nominal).unwrap_or(nominal);
        let horizon = self.horizon(input.reference, &last);
        let of_world = |deviation: &Velocity| out_of_frame(&self.state.forward, deviation);
        let start = core::array::from_fn(|index| match index {
            POSITION => error,
            VELOCITY => of_world(&self.state.deviation),
            COMMAND => self.state.applied[0] - last,
            older => of_world(&self.state.deviations[(older - COMMAND) * stage]),
        });
        let residual = self.solver.solve(&start, &horizon, self.config.iterations);
        let acceleration = self.solver.plan()[0].acceleration + horizon[0].acceleration;
        if residual.primal.is_nan() || residual.primal > ABSURD {
            return self.brake();
        }
        let converged = residual.primal < CONVERGED && residual.dual < CONVERGED;
        self.choose(&input.point, &acceleration, converged)
    }

    fn reset(&mut self) {
        self.solver.reset();
        self.state = PlanState::NEW;
    }

    fn plans(&self) -> bool {
        true
    }
}

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

    fn tracking(&mut self) -> &mut dyn OuterLoop {
        match self {
            Self::Prompt(tracking) => tracking,
            Self::Late(tracking) => tracking,
        }
    }
}

impl OuterLoop for DelayedMpc {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        self.tracking().step(input)
    }

    fn reset(&mut self) {
        self.tracking().reset();
    }

    fn plans(&self) -> bool {
        true
    }
}
