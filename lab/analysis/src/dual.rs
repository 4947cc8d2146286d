//! Dual numbers, which carry exact derivatives, in the vehicle models.

use singletrack_control::Functions;
pub(crate) use singletrack_sim::integrator::Dual;

/// The elementary functions of dual numbers.
pub(crate) enum DualFunctions {}

impl<D: Dual> Functions<D> for DualFunctions {
    fn sin_cos(angle: D) -> (D, D) {
        angle.sin_cos()
    }

    /// Takes half the time of the quotient of the hyperbolic sine and cosine.
    fn tanh(x: D) -> D {
        // Beyond this the result is ±1 to the last bit, and the exponential overflows.
        if x.re().abs() > 20.0 {
            return D::from(x.re().signum());
        }
        let square = (x * 2.0).exp();
        (square - 1.0) / (square + 1.0)
    }

    fn atan2(y: D, x: D) -> D {
        y.atan2(x)
    }
}

#[cfg(test)]
mod tests {
    use num_dual::Dual64;

    use super::*;

    fn tanh(x: f64) -> Dual64 {
        DualFunctions::tanh(Dual64::from(x).derivative())
    }

    #[test]
    fn the_hyperbolic_tangent_has_its_value_and_its_derivative() {
        for x in [-19.9, -3.0, -0.2, 0.0, 0.7, 5.0, 19.9] {
            let expected = libm::tanh(x);
            assert!((tanh(x).re - expected).abs() < 1e-15);
            assert!((tanh(x).eps - (1.0 - expected * expected)).abs() < 1e-15);
        }
        for x in [-1e3, -20.1, 20.1, 1e3] {
            assert_eq!(tanh(x), Dual64::from(x.signum()));
            assert_eq!(tanh(x).eps, 0.0);
        }
    }
}
