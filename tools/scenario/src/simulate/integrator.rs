//! Dormand and Prince's embedded Runge-Kutta pair of order 5(4).
//!
//! It uses `libm` alone, so that a scenario gives the same bits on every platform. No
//! crate offers that.

use nalgebra::SVector;

/// Largest local error of a component in one step, absolute and relative.
const TOLERANCE: f64 = 1e-12;

/// Smaller steps than this, in s, mean that the equations have no solution here.
const SMALLEST_STEP: f64 = 1e-12;

/// The equations became singular.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the integration can't go on beyond t = {time} s: the equations are singular there")]
pub struct IntegrationError {
    /// The time at which it stopped, in s.
    pub time: f64,
}

/// An adaptive integrator for N equations; remembers its step size from one
/// interval to the next.
pub(crate) struct Integrator<const N: usize> {
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

impl<const N: usize> Integrator<N> {
    pub(crate) fn new() -> Self {
        Self { step: 1e-3 }
    }

    /// Integrates `state` from `start` to `end` under `derivative(t, state)`.
    ///
    /// # Errors
    ///
    /// The derivative's own error, and [`IntegrationError`] where the equations
    /// are singular.
    pub(crate) fn advance<E: From<IntegrationError>>(
        &mut self,
        state: &mut SVector<f64, N>,
        start: f64,
        end: f64,
        mut derivative: impl FnMut(f64, &SVector<f64, N>) -> Result<SVector<f64, N>, E>,
    ) -> Result<(), E> {
        let mut time = start;
        while time < end {
            let remaining = end - time;
            let last = self.step >= remaining;
            let step = if last { remaining } else { self.step };

            let mut slopes = [SVector::<f64, N>::zeros(); 7];
            slopes[0] = derivative(time, state)?;
            let mut candidate = *state;
            for (stage, (node, weights)) in NODES.iter().zip(&STAGES).enumerate() {
                candidate = *state;
                for (slope, weight) in slopes.iter().take(stage + 1).zip(weights) {
                    candidate += step * *weight * slope;
                }
                let at = if *node == 1.0 && last {
                    end
                } else {
                    time + node * step
                };
                slopes[stage + 1] = derivative(at, &candidate)?;
            }

            let mut error: f64 = 0.0;
            for component in 0..N {
                let estimate: f64 = slopes
                    .iter()
                    .zip(&ERROR)
                    .map(|(slope, weight)| weight * slope[component])
                    .sum();
                let scale =
                    TOLERANCE * (1.0 + state[component].abs().max(candidate[component].abs()));
                let ratio = (step * estimate / scale).abs();
                // NaN must not pass as a small error.
                error = if ratio.is_finite() {
                    error.max(ratio)
                } else {
                    f64::INFINITY
                };
            }

            let factor = if error == 0.0 {
                5.0
            } else {
                (0.9 * libm::pow(error, -0.2)).clamp(0.2, 5.0)
            };
            if error <= 1.0 {
                time = if last { end } else { time + step };
                *state = candidate;
                // A step shortened by the end of the interval says nothing about the next.
                if !last || factor < 1.0 {
                    self.step = step * factor;
                }
            } else {
                self.step = step * factor;
                if self.step < SMALLEST_STEP {
                    return Err(IntegrationError { time }.into());
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;

    #[test]
    fn an_oscillator_keeps_its_circle_for_a_hundred_turns() {
        let mut state = Vector2::new(1.0, 0.0);
        let end = 200.0 * core::f64::consts::PI;
        Integrator::new()
            .advance::<IntegrationError>(&mut state, 0.0, end, |_, x| Ok(Vector2::new(x.y, -x.x)))
            .unwrap();
        assert!((state - Vector2::new(1.0, 0.0)).norm() < 1e-8, "{state}");
    }

    #[test]
    fn a_stiff_mode_stays_stable() {
        let mut state = nalgebra::Vector1::new(1.0);
        Integrator::new()
            .advance::<IntegrationError>(&mut state, 0.0, 1.0, |t, x| {
                Ok(nalgebra::Vector1::new(-5000.0 * (x.x - libm::cos(t))))
            })
            .unwrap();
        assert!((state.x - libm::cos(1.0)).abs() < 2e-4);
    }

    #[test]
    fn a_pole_is_reported_with_its_time() {
        let mut state = nalgebra::Vector1::new(1.0);
        let error = Integrator::new()
            .advance::<IntegrationError>(&mut state, 0.0, 2.0, |_, x| Ok(x.component_mul(x)))
            .unwrap_err();
        assert!((error.time - 1.0).abs() < 1e-6, "{error}");
    }
}
