//! Dormand and Prince's embedded Runge-Kutta pair of order 5(4).
//!
//! It uses `libm` alone, so that it gives the same bits on every platform, and integrates dual
//! numbers, so that the derivatives of the solution are exact. No crate offers that.

#![deny(clippy::disallowed_methods, reason = "simulated drives begin here")]

use nalgebra::{Const, U1};
use num_dual::{DualNum, DualSVec64};

/// A dual number of any order, or `f64`.
pub trait Dual: DualNum<Primitive = f64> + Copy {}

impl<D: DualNum<Primitive = f64> + Copy> Dual for D {}

/// Largest local error of a component in one step, absolute and relative.
const TOLERANCE: f64 = 1e-12;
/// Largest local error of a component's derivatives in one step: where a slope has a corner, they
/// have a jump.
const DERIVATIVE_TOLERANCE: f64 = 1e-10;

/// Smaller steps than this, in s, mean that the equations have no solution here.
const SMALLEST_STEP: f64 = 1e-12;

/// The equations became singular.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the integration can't go on beyond t = {time} s: the equations are singular there")]
pub struct IntegrationError {
    /// The time at which it stopped, in s.
    pub time: f64,
}

/// An adaptive integrator; remembers its step size from one interval to the next.
#[derive(Clone, Debug)]
pub struct Integrator {
    step: f64,
}

/// Nodes of the pair (the first is 0, the last two are 1).
const NODES: [f64; 6] = [0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];

/// Stage weights; the last row is the solution of order five.
const STAGES: [[f64; 6]; 6] = [
    [0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
    [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
    [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
    [
        19372.0 / 6561.0,
        -25360.0 / 2187.0,
        64448.0 / 6561.0,
        -212.0 / 729.0,
        0.0,
        0.0,
    ],
    [
        9017.0 / 3168.0,
        -355.0 / 33.0,
        46732.0 / 5247.0,
        49.0 / 176.0,
        -5103.0 / 18656.0,
        0.0,
    ],
    [
        35.0 / 384.0,
        0.0,
        500.0 / 1113.0,
        125.0 / 192.0,
        -2187.0 / 6784.0,
        11.0 / 84.0,
    ],
];

/// Order five minus order four: the error estimate.
const ERROR: [f64; 7] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339_200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// A number whose error can be bounded.
pub trait Bounded: Dual {
    /// The error of a step between two values over what is tolerated.
    fn ratio(error: Self, old: Self, new: Self) -> f64;
}

impl Bounded for f64 {
    fn ratio(error: Self, old: Self, new: Self) -> f64 {
        ratio(error, old, new, TOLERANCE)
    }
}

/// Without a bound of their own, derivatives would grow: the values at rest allow steps that are
/// too long for a stiff mode.
impl<const P: usize> Bounded for DualSVec64<P> {
    fn ratio(error: Self, old: Self, new: Self) -> f64 {
        let [of_error, of_old, of_new] =
            [error, old, new].map(|number| number.eps.unwrap_generic(Const::<P>, U1));
        let derivatives = of_error.zip_zip_map(&of_old, &of_new, |error, old, new| {
            ratio(error, old, new, DERIVATIVE_TOLERANCE)
        });
        f64::ratio(error.re, old.re, new.re).max(derivatives.max())
    }
}

fn ratio(error: f64, old: f64, new: f64, tolerance: f64) -> f64 {
    (error / (tolerance * (1.0 + old.abs().max(new.abs())))).abs()
}

/// A state of N numbers.
type State<D, const N: usize> = [D; N];

impl Integrator {
    /// An integrator whose first step is 1 ms.
    pub const fn new() -> Self {
        Self { step: 1e-3 }
    }

    /// Integrates `state` from `start` to `end` (s) under `derivative(t, state)`.
    ///
    /// # Errors
    ///
    /// The derivative's own error, and [`IntegrationError`] where the equations
    /// are singular.
    pub fn advance<D: Bounded, E: From<IntegrationError>, const N: usize>(
        &mut self,
        state: &mut State<D, N>,
        start: D,
        end: D,
        mut derivative: impl FnMut(f64, &State<D, N>) -> Result<State<D, N>, E>,
    ) -> Result<(), E> {
        let mut time = start;
        while time.re() < end.re() {
            time = self.step(state, time, end, &mut derivative)?;
        }
        Ok(())
    }

    /// Advances `state` by one step of its own choice, not beyond `end`, and returns where it
    /// ends.
    ///
    /// # Errors
    ///
    /// Those of [`Integrator::advance`].
    pub fn step<D: Bounded, E: From<IntegrationError>, const N: usize>(
        &mut self,
        state: &mut State<D, N>,
        time: D,
        end: D,
        derivative: &mut impl FnMut(f64, &State<D, N>) -> Result<State<D, N>, E>,
    ) -> Result<D, E> {
        loop {
            let remaining = end - time;
            let last = self.step >= remaining.re();
            let step = if last { remaining } else { D::from(self.step) };
            let to = if last { end } else { time + step };
            let (candidate, error) = stages(state, time.re(), step, to.re(), derivative)?;
            // Without any error the power is infinite.
            let factor = (0.9 * libm::pow(error, -0.2)).clamp(0.2, 5.0);
            // A step shortened by the end of the interval says nothing about the next.
            if !last || factor < 1.0 {
                self.step = step.re() * factor;
            }
            if error <= 1.0 {
                *state = candidate;
                return Ok(to);
            }
            if self.step < SMALLEST_STEP {
                return Err(IntegrationError { time: time.re() }.into());
            }
        }
    }
}

impl Default for Integrator {
    fn default() -> Self {
        Self::new()
    }
}

/// The state a step later, at `to`, and the error over what is tolerated.
///
/// # Errors
///
/// The derivative's own.
pub fn stages<D: Bounded, E, const N: usize>(
    state: &State<D, N>,
    time: f64,
    step: D,
    to: f64,
    derivative: &mut impl FnMut(f64, &State<D, N>) -> Result<State<D, N>, E>,
) -> Result<(State<D, N>, f64), E> {
    let mut slopes = [[D::from(0.0); N]; 7];
    slopes[0] = derivative(time, state)?;
    let mut candidate = *state;
    for (stage, (node, weights)) in NODES.iter().zip(&STAGES).enumerate() {
        candidate = *state;
        for (slope, weight) in slopes.iter().take(stage + 1).zip(weights) {
            let weight = step * *weight;
            for (x, slope) in candidate.iter_mut().zip(slope) {
                *x += weight * *slope;
            }
        }
        let within = time + node * step.re();
        let at = if *node == 1.0 { to } else { within };
        slopes[stage + 1] = derivative(at, &candidate)?;
    }

    let mut error: f64 = 0.0;
    for component in 0..N {
        let mut estimate = D::from(0.0);
        for (slope, weight) in slopes.iter().zip(&ERROR) {
            estimate += slope[component] * *weight;
        }
        let ratio = D::ratio(estimate * step, state[component], candidate[component]);
        // NaN must not pass as a small error.
        error = if ratio.is_finite() {
            error.max(ratio)
        } else {
            f64::INFINITY
        };
    }
    Ok((candidate, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(
        mut state: [f64; 2],
        end: f64,
        slope: impl Fn(f64, &[f64; 2]) -> [f64; 2],
    ) -> Result<[f64; 2], IntegrationError> {
        Integrator::new().advance(&mut state, 0.0, end, |t, x| Ok(slope(t, x)))?;
        Ok(state)
    }

    #[test]
    fn an_oscillator_keeps_its_circle_for_a_hundred_turns() {
        let end = 200.0 * core::f64::consts::PI;
        let [x, v] = after([1.0, 0.0], end, |_, [x, v]| [*v, -x]).unwrap();
        assert!(libm::hypot(x - 1.0, v) < 1e-8, "{x} {v}");
    }

    #[test]
    fn a_stiff_mode_stays_stable() {
        let stiff = |t: f64, [x, _]: &[f64; 2]| [-5000.0 * (x - libm::cos(t)), 0.0];
        let [x, _] = after([1.0, 0.0], 1.0, stiff).unwrap();
        assert!((x - libm::cos(1.0)).abs() < 2e-4);
    }

    #[test]
    fn a_pole_is_reported_with_its_time() {
        let error = after([1.0, 0.0], 2.0, |_, [x, _]| [x * x, 0.0]).unwrap_err();
        assert!((error.time - 1.0).abs() < 1e-6, "{error}");
    }

    /// x = x₀ exp(t): by x₀ and by the end of the interval alike.
    #[test]
    fn dual_numbers_carry_the_derivatives_by_the_start_and_by_the_time() {
        for [by_start, by_end] in [[1.0, 0.0], [0.0, 1.0]] {
            let dual = |value: f64, by: f64| {
                DualSVec64::<1>::from(value).derivative(0) * by + value * (1.0 - by)
            };
            let mut state = [dual(2.0, by_start)];
            let end = dual(1.5, by_end);
            Integrator::new()
                .advance::<_, IntegrationError, 1>(&mut state, 0.0.into(), end, |_, x| Ok(*x))
                .unwrap();
            let expected = (by_start + 2.0 * by_end) * libm::exp(1.5);
            let derivative = state[0].eps.unwrap_generic(Const::<1>, U1)[0];
            assert!((derivative - expected).abs() < 1e-10, "{derivative}");
        }
    }
}
