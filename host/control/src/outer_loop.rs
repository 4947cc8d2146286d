//! The outer loop: from P and its reference to the velocity of P, once per tick.
//!
//! The linearised system is two integrators, so any linear controller is suitable; the
//! paper uses a proportional one. [`LqiLoop`] adds integral action, with linear-quadratic gains in
//! the reference's frame; the predictive loop is in `mpc`.

use libm::{cos, exp, fabs, sin, sqrt};
use nalgebra::{Matrix1, Matrix2, Matrix3, RowVector3, SMatrix, Vector3};

use crate::{
    Position, ReferencePoint, Velocity,
    riccati::{QuadraticRegulator, RiccatiError},
};

/// What an outer loop is given at a tick.
#[derive(Clone, Copy)]
pub struct TrackingInput<'a> {
    /// The position of P, in m.
    pub point: Position,
    /// The reference, by the time from now in s: at 0, and ahead for a loop that looks ahead.
    pub reference: &'a dyn Fn(f64) -> ReferencePoint,
    /// The velocity that P was given in the last tick, after every limit (m/s). It differs from
    /// the loop's own answer where something limited it, and the loop must not wind up then.
    pub applied: Velocity,
    /// The time until the next tick, in s.
    pub period: f64,
}

/// A controller of two integrators: it moves P to its reference.
///
/// It has a state, allocates nothing, and the same inputs give the same bits.
pub trait OuterLoop {
    /// One tick: the commanded velocity of P, in m/s.
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity;

    /// Forgets the past: the car stands, and a drive begins.
    fn reset(&mut self);

    /// Whether it plans P's motion on from [`TrackingInput::applied`]. Where dead times are
    /// compensated that is then the velocity which P is given when the command acts.
    fn plans(&self) -> bool {
        false
    }
}

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

/// Below this speed of the reference (m/s) its frame keeps its direction.
const TURNS_FROM: f64 = 0.02;
/// A command that was changed by more than this (m/s) counts as limited.
const LIMITED: f64 = 1e-9;
/// The loop counts as settled after 2^`DOUBLINGS` periods (44 minutes at 100 Hz) when not more
/// than `SETTLED` of anything is left.
const DOUBLINGS: usize = 18;
const SETTLED: f64 = 1e-6;

/// One axis of the reference's frame: how P follows its commanded velocity there, and what
/// errors cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LqiAxis {
    /// Time constant from the commanded velocity of P to its velocity, in s; 0 for an ideal
    /// car, or where a predictor compensates the actuators.
    pub lag: f64,
    /// Weight of the error's integral, (m s)⁻².
    pub integral_weight: f64,
    /// Weight of the error, m⁻².
    pub error_weight: f64,
    /// Weight of the correcting velocity, (m/s)⁻².
    pub velocity_weight: f64,
}

impl LqiAxis {
    /// The matrices of this axis with a control period of `period` (s). The state is the error's
    /// integral, the error, and the velocity of P relative to the reference's; the input is the
    /// commanded relative velocity, held over the period.
    pub fn regulator(&self, period: f64) -> QuadraticRegulator<3, 1> {
        let kept = kept_by_lag(self.lag, period);
        // The way that the present velocity makes by itself.
        let coasted = self.lag * (1.0 - kept);
        QuadraticRegulator {
            transition: Matrix3::new(1.0, period, 0.0, 0.0, 1.0, coasted, 0.0, 0.0, kept),
            input: Vector3::new(0.0, period - coasted, 1.0 - kept),
            state_weight: Matrix3::from_diagonal(&Vector3::new(
                self.integral_weight,
                self.error_weight,
                0.0,
            )),
            input_weight: Matrix1::new(self.velocity_weight),
        }
    }
}

/// What of a velocity is left after `period` (s) with a lag of `lag` (s).
pub(crate) fn kept_by_lag(lag: f64, period: f64) -> f64 {
    if lag > 0.0 { exp(-period / lag) } else { 0.0 }
}

/// The settings of a [`LqiLoop`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LqiConfig {
    /// Along the reference's velocity.
    pub along: LqiAxis,
    /// Across it, to the left.
    pub across: LqiAxis,
    /// The largest velocity that the integral may add on either axis, in m/s.
    pub integral_limit: f64,
    /// The fastest turn of the reference that the loop must stand, in rad/s.
    pub turn_rate: f64,
    /// The control period, in s.
    pub period: f64,
}

/// Linear-quadratic control with integral action, in the frame of the reference's velocity.
///
/// What stays constant along and across a path (a gain of the motor, a trim of the servo) is
/// constant in that frame and not in the world's; the integral removes it there. The frame
/// turns with the reference, which couples the axes: the faster it turns, the less a slow loop
/// settles. [`LqiLoop::new`] computes both axes together at the stated rate of turn.
///
/// The reference's speed is fed forward as it will be one lag later, so that a lag of first order
/// costs nothing to first order; its direction is the present one, because the law turns with
/// the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LqiLoop {
    config: LqiConfig,
    gains: [RowVector3<f64>; 2],
    state: LqiState,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct LqiState {
    /// The integral of the error, along and across, in m s.
    integral: Velocity,
    /// The velocity of P by the model of its lag, along and across, in m/s.
    velocity: Velocity,
    /// The direction of the reference's velocity; along x until it moves.
    forward: Velocity,
    /// The last answer, in m/s.
    answer: Velocity,
}

impl LqiState {
    const NEW: Self = Self {
        integral: Velocity::new(0.0, 0.0),
        velocity: Velocity::new(0.0, 0.0),
        forward: Velocity::new(1.0, 0.0),
        answer: Velocity::new(0.0, 0.0),
    };
}

/// The direction of the reference, or the last one if it hardly moves.
pub(crate) fn forward_of(velocity: &Velocity, last: &Velocity) -> Velocity {
    let speed = sqrt(velocity.norm_squared());
    if speed >= TURNS_FROM && speed.is_finite() {
        velocity / speed
    } else {
        *last
    }
}

/// Why there is no [`LqiLoop`].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LqiError {
    /// The weights make no regulator: every weight must be above zero.
    #[error(transparent)]
    Gains(#[from] RiccatiError),
    /// The axes, coupled by the turn of the frame, do not settle.
    #[error(
        "the loop does not settle while the reference turns by {0} rad/s: lower the weight of \
         the velocity, or the lags by a predictor, or ask for slower turns"
    )]
    Turns(f64),
}

/// Whether the loop settles while the reference turns by `rate` (rad/s) all the time: the powers
/// of its transition vanish. `loops` are the transitions of both axes without a turn.
fn settles(loops: &[Matrix3<f64>; 2], rate: f64, period: f64) -> bool {
    let turn = rate * period;
    // The error and the velocity are seen from axes that turn; the integrals belong to the axes.
    let rotation = Matrix2::new(cos(turn), sin(turn), -sin(turn), cos(turn));
    let mut turned = SMatrix::<f64, 6, 6>::identity();
    for state in 1..3 {
        turned
            .fixed_view_mut::<2, 2>(2 * state, 2 * state)
            .copy_from(&rotation);
    }
    let straight = SMatrix::<f64, 6, 6>::from_fn(|row, column| {
        if row % 2 == column % 2 {
            loops[row % 2][(row / 2, column / 2)]
        } else {
            0.0
        }
    });
    let mut power = turned * straight;
    for _ in 0..DOUBLINGS {
        power *= power;
    }
    // Not so either where a power has overflowed.
    power.iter().all(|left| fabs(*left) <= SETTLED)
}

impl LqiLoop {
    /// Computes the gains, and both axes together at the stated rate of turn.
    ///
    /// # Errors
    ///
    /// [`LqiError`] where the weights make no regulator, or the loop does not settle.
    pub fn new(config: LqiConfig) -> Result<Self, LqiError> {
        let usable = |axis: &LqiAxis| axis.lag.is_finite() && axis.lag >= 0.0;
        let limits = config.integral_limit.is_finite() && config.integral_limit >= 0.0;
        let period = config.period.is_finite() && config.period > 0.0;
        let turns = config.turn_rate.is_finite() && config.turn_rate >= 0.0;
        if !(usable(&config.along) && usable(&config.across) && limits && period && turns) {
            return Err(RiccatiError::NotFinite.into());
        }
        let [along, across] = [config.along, config.across].map(|it| it.regulator(config.period));
        let gains = [along.solve()?.gain, across.solve()?.gain];
        let loops = [
            along.transition - along.input * gains[0],
            across.transition - across.input * gains[1],
        ];
        if !settles(&loops, config.turn_rate, config.period) {
            return Err(LqiError::Turns(config.turn_rate));
        }
        Ok(Self {
            config,
            gains,
            state: LqiState::NEW,
        })
    }

    /// The gains along and across: of the error's integral (1/s²), of the error (1/s), and of
    /// the velocity.
    pub const fn gains(&self) -> &[RowVector3<f64>; 2] {
        &self.gains
    }

    /// The integral of the error along and across, in m s.
    pub const fn integral(&self) -> Velocity {
        self.state.integral
    }
}

impl OuterLoop for LqiLoop {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        let reference = (input.reference)(0.0);
        let Some(position) = reference.position else {
            // Only a velocity is asked for: nothing is tracked.
            self.reset();
            return reference.velocity;
        };
        let last = self.state;
        let forward = forward_of(&reference.velocity, &last.forward);
        let left = Velocity::new(-forward.y, forward.x);
        self.state.forward = forward;
        let axes = [(forward, &self.config.along), (left, &self.config.across)];

        // The velocity of P at this tick, by what it was given since the last one. On a circle
        // the commands to motor and servo are constant: the lag is in the frame that turns.
        for (index, (axis, setting)) in axes.iter().enumerate() {
            let kept = kept_by_lag(setting.lag, input.period);
            let velocity = kept * last.velocity[index] + (1.0 - kept) * axis.dot(&input.applied);
            if velocity.is_finite() {
                self.state.velocity[index] = velocity;
            }
        }

        let error = input.point - position;
        let ahead = (input.reference)(self.config.along.lag).velocity;
        let wanted = Velocity::new(sqrt(ahead.norm_squared()), 0.0);
        let present = Velocity::new(sqrt(reference.velocity.norm_squared()), 0.0);
        let relative = self.state.velocity - present;
        let limited = (input.applied - last.answer).amax() > LIMITED;
        let mut answer = Velocity::zeros();
        for (index, (axis, _)) in axes.into_iter().enumerate() {
            let gain = &self.gains[index];
            let error = axis.dot(&error);
            let most = self.config.integral_limit / gain[0];
            let grown = (last.integral[index] + input.period * error).clamp(-most, most);
            // A command that was limited must not wind the integral up; it may unwind.
            let unwinds = fabs(grown) < fabs(last.integral[index]);
            if grown.is_finite() && (unwinds || !limited) {
                self.state.integral[index] = grown;
            }
            let correction =
                gain[0] * last.integral[index] + gain[1] * error + gain[2] * relative[index];
            answer += axis * (wanted[index] - correction);
        }
        self.state.answer = answer;
        answer
    }

    fn reset(&mut self) {
        self.state = LqiState::NEW;
    }
}
