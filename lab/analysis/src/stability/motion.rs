//! Large motions of the closed loop, where tyres and steering may saturate, and the basin of the straight
//! motion: from which yaw errors the car regains it.
//!
//! Tyres, clamped rates and the way off a steering stop change the slope without a jump, which
//! the integrator's error control resolves. The way onto the stop is a jump: it is located, and
//! the step ends there. On dual numbers the moment of contact has its own derivatives.

use num_dual::Dual64;
use singletrack_sim::integrator::{Bounded, IntegrationError, Integrator, stages};

use super::{
    closed_loop::{ClosedLoop, Law, StabilityError},
    sampled::Servo,
    vector_field::{FrontPointField, ServoField, VectorField, VelocityPointField},
};
use crate::dual::Dual;

/// Steps of one motion: many times those of a long cycle of a slow car.
const MOST_STEPS: u32 = 200_000;

/// A motion of N states, in rad and s.
pub(super) struct Motion<'a, F, D, const N: usize> {
    field: &'a F,
    deviation: D,
    pub(super) state: [D; N],
    pub(super) time: D,
    /// The sides of its steering stop, or zero: ±1.
    stop: f64,
    /// The largest steering angle so far, in rad.
    pub(super) amplitude: f64,
    integrator: Integrator,
    steps: u32,
}

impl<'a, F: VectorField<N>, D: Bounded, const N: usize> Motion<'a, F, D, N> {
    pub(super) fn new(field: &'a F, state: [D; N], deviation: D) -> Self {
        Self {
            field,
            deviation,
            state,
            time: D::from(0.0),
            stop: 0.0,
            amplitude: 0.0,
            integrator: Integrator::new(),
            steps: 0,
        }
    }

    /// Goes on by a step, not beyond `end`.
    ///
    /// # Errors
    ///
    /// The equations are singular.
    pub(super) fn step(&mut self, end: D) -> Result<(), IntegrationError> {
        let (field, deviation, stop) = (self.field, self.deviation, self.stop);
        let (begin, before) = (self.time, self.state);
        self.steps += 1;
        if self.steps > MOST_STEPS {
            return Err(IntegrationError { time: begin.re() });
        }
        let mut slope = |_: f64, state: &[D; N]| -> Result<_, IntegrationError> {
            Ok(held(field.slope_at(state, deviation), stop))
        };
        let time = self
            .integrator
            .step(&mut self.state, begin, end, &mut slope)?;
        let length = (time - begin).re();

        // In real numbers, for what lies within the step.
        let (real, real_deviation) = (before.map(|x| x.re()), deviation.re());
        let mut real_slope = |_: f64, state: &[f64; N]| -> Result<_, IntegrationError> {
            Ok(held(field.slope_at(state, real_deviation), stop))
        };
        let mut within = |length: f64| stages(&real, 0.0, length, length, &mut real_slope);
        let steering = |state: &[f64; N]| field.steering(state, real_deviation);
        let turning = |state: &[f64; N]| {
            let mut moving = state.map(Dual64::from);
            let slope = held(field.slope_at(state, real_deviation), stop);
            for (x, slope) in moving.iter_mut().zip(slope) {
                x.eps = slope;
            }
            field.steering(&moving, Dual64::from(real_deviation)).eps
        };

        let mut farthest = self.state.map(|x| x.re());
        let mut reach = length;
        let away = turning(&real).signum();
        if away * turning(&farthest) < 0.0 {
            reach = crossing(length, |length| Ok(-away * turning(&within(length)?.0)))?;
            (farthest, _) = within(reach)?;
        }
        let most = field.closed_loop().saturation.max_steering;
        let farthest = steering(&farthest);
        self.amplitude = self.amplitude.max(farthest.abs().min(most));
        self.time = time;
        if stop == 0.0 && farthest.abs() > most {
            let side = farthest.signum();
            let contact = crossing(reach, |length| {
                Ok(side * steering(&within(length)?.0) - most)
            })?;
            let mut to = D::from(contact);
            // A step of Newton's method moves the moment by less than its rounding, and gives it
            // its derivatives.
            let (at, _) = stages(&before, 0.0, to, contact, &mut slope)?;
            to -= (at[N - 1] - side * most) / field.slope_at(&at, deviation)[N - 1];
            (self.state, _) = stages(&before, 0.0, to, contact, &mut slope)?;
            self.state[N - 1] = D::from(side * most);
            self.time = begin + to;
            self.stop = side;
        } else if self.state[N - 1].re().abs() < most {
            self.stop = 0.0;
        }
        Ok(())
    }
}

/// A slope whose last state, the steering, is held from outside a stop on a side.
fn held<D: Dual, const N: usize>(mut slope: [D; N], stop: f64) -> [D; N] {
    if let Some(rate) = slope.last_mut()
        && stop * rate.re() > 0.0
    {
        *rate = D::from(0.0);
    }
    slope
}

/// Where on the way to `end` a value becomes positive.
fn crossing<E>(end: f64, mut value: impl FnMut(f64) -> Result<f64, E>) -> Result<f64, E> {
    let (mut low, mut high) = (0.0, end);
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return Ok(high);
        }
        if value(middle)? > 0.0 {
            high = middle;
        } else {
            low = middle;
        }
    }
}

/// The yaw errors from which a car regains the straight motion; all other states are zero at
/// first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basin {
    /// The car regains it from every smaller yaw error, in rad; pi if from every one.
    pub yaw: f64,
    /// Half the peak-to-peak steering angle in which the car ends just beyond, in rad. None if
    /// the law or the car becomes singular: P does not determine a car that moves forward.
    pub beyond: Option<f64>,
}

/// What becomes of a yaw error.
enum Outcome {
    Regained,
    Swings(f64),
    Singular,
}

/// The time after which a motion that has not decayed swings on, and after which its amplitude is
/// taken, in s.
const BASIN_LONGEST: f64 = 30.0;
const BASIN_SETTLED: f64 = 20.0;
/// A motion whose states are as small as this, in rad and rad/s, decays.
const BASIN_SMALL: f64 = 1e-3;
/// Steps of the search over yaw, and halvings of the one that has the edge.
const BASIN_STEPS: u32 = 180;
const BASIN_HALVINGS: u32 = 12;

impl ClosedLoop {
    /// The basin of the straight motion over the yaw error, with wheels that follow at once or,
    /// under the front-point law, by a servo.
    ///
    /// # Errors
    ///
    /// A servo under the law of the appendix, or one without lag or dead time.
    pub fn basin(&self, servo: Option<Servo>) -> Result<Basin, StabilityError> {
        match (self.law, servo) {
            (Law::FrontPoint, None) => Ok(search(&FrontPointField(self))),
            (Law::VelocityPoint, None) => Ok(search(&VelocityPointField(self))),
            (Law::FrontPoint, Some(servo)) if servo.lag > 0.0 && servo.dead_time > 0.0 => {
                Ok(search(&ServoField(self, servo)))
            }
            (_, Some(_)) => Err(StabilityError::Servo),
        }
    }

    /// Whether the straight motion is regained from a yaw error, in rad, with the servo of [`basin`](Self::basin).
    pub fn regains(&self, servo: Option<Servo>, yaw: f64) -> bool {
        let outcome = match (self.law, servo) {
            (Law::VelocityPoint, _) => outcome(&VelocityPointField(self), yaw),
            (Law::FrontPoint, None) => outcome(&FrontPointField(self), yaw),
            (Law::FrontPoint, Some(servo)) => outcome(&ServoField(self, servo), yaw),
        };
        matches!(outcome, Outcome::Regained)
    }
}

fn search<const N: usize>(field: &impl VectorField<N>) -> Basin {
    let is_regained = |yaw: f64| matches!(outcome(field, yaw), Outcome::Regained);
    let step = core::f64::consts::PI / f64::from(BASIN_STEPS);
    let Some(first) = (1..=BASIN_STEPS).find(|steps| !is_regained(step * f64::from(*steps))) else {
        return Basin {
            yaw: core::f64::consts::PI,
            beyond: None,
        };
    };
    let [mut inside, mut outside] = [first - 1, first].map(|steps| step * f64::from(steps));
    for _ in 0..BASIN_HALVINGS {
        let middle = 0.5 * (inside + outside);
        if is_regained(middle) {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    Basin {
        yaw: inside,
        beyond: match outcome(field, outside) {
            Outcome::Swings(amplitude) => Some(amplitude),
            Outcome::Regained | Outcome::Singular => None,
        },
    }
}

fn outcome<const N: usize>(field: &impl VectorField<N>, yaw: f64) -> Outcome {
    let mut start = [0.0; N];
    start[0] = yaw;
    let mut motion = Motion::new(field, start, field.closed_loop().deviation);
    for end in [BASIN_SETTLED, BASIN_LONGEST] {
        motion.amplitude = 0.0;
        while motion.time < end {
            if motion.step(end).is_err() {
                return Outcome::Singular;
            }
            if motion.state.iter().all(|x| x.abs() < BASIN_SMALL) {
                return Outcome::Regained;
            }
        }
    }
    Outcome::Swings(motion.amplitude)
}
