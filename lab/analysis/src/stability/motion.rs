//! Large motions of the closed loop, where tyres and steering may saturate.
//!
//! Tyres, clamped rates and the way off a steering stop change the slope without a jump, which
//! the integrator's error control resolves. The way onto the stop is a jump: it is located, and
//! the step ends there. On dual numbers the moment of contact has its own derivatives.

use num_dual::Dual64;

use singletrack_sim::integrator::{Bounded, IntegrationError, Integrator, stages};

use super::vector_field::VectorField;
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
