//! The numbers that the vehicle models compute with.
//!
//! On the car and in the simulator these are `f64` with the functions of [`Libm`]. An
//! analysis brings dual numbers, which carry exact derivatives, and their functions. The
//! models need nothing of a number but the two traits here.

use core::ops::{Add, Div, Mul, Neg, Sub};

/// The arithmetic of a number whose model has parameters of type `P`.
///
/// `P` is `f64`, or the number itself for derivatives by the parameters.
/// Every type with these operations is a number.
pub trait Number<P = f64>:
    Copy
    + PartialOrd
    + From<f64>
    + From<P>
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Mul<P, Output = Self>
    + Div<P, Output = Self>
{
}

impl<P, N> Number<P> for N where
    N: Copy
        + PartialOrd
        + From<f64>
        + From<P>
        + Neg<Output = N>
        + Add<Output = N>
        + Sub<Output = N>
        + Mul<Output = N>
        + Div<Output = N>
        + Mul<P, Output = N>
        + Div<P, Output = N>
{
}

/// The elementary functions of the number `N`.
///
/// The trait belongs to a type beside the number, so that another crate can supply the
/// functions of numbers that it does not own.
pub trait Functions<N> {
    /// Sine and cosine of an angle in rad.
    fn sin_cos(angle: N) -> (N, N);

    /// Hyperbolic tangent.
    fn tanh(x: N) -> N;

    /// Angle of the point (x, y) from the x axis, in rad.
    fn atan2(y: N, x: N) -> N;
}

/// The functions of `f64` by `libm`: the same bits on every platform and in every build.
#[derive(Clone, Copy, Debug)]
pub enum Libm {}

impl Functions<f64> for Libm {
    fn sin_cos(angle: f64) -> (f64, f64) {
        libm::sincos(angle)
    }

    fn tanh(x: f64) -> f64 {
        libm::tanh(x)
    }

    fn atan2(y: f64, x: f64) -> f64 {
        libm::atan2(y, x)
    }
}

#[cfg(test)]
mod tests {
    use super::{Functions, Libm};

    #[test]
    fn sine_and_cosine_together_have_the_bits_of_each_alone() {
        let check = |angle: f64| {
            let (sine, cosine) = Libm::sin_cos(angle);
            let alone = (libm::sin(angle), libm::cos(angle));
            assert_eq!(sine.to_bits(), alone.0.to_bits(), "{angle:?}");
            assert_eq!(cosine.to_bits(), alone.1.to_bits(), "{angle:?}");
        };
        for angle in [0.0, f64::MIN_POSITIVE, 5e-324] {
            check(angle);
            check(-angle);
        }
        // Around the arguments at which the approximations change, and all over the range.
        for exponent in -40..60 {
            for step in 0..1_000 {
                let angle = libm::ldexp(1.0 + f64::from(step) * 0.001, exponent);
                check(angle);
                check(-angle);
            }
        }
    }
}
