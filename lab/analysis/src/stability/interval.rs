//! Intervals that hold the real number, with their derivatives by N coordinates: what the
//! certificate of a [region of attraction](super::Attraction) computes with.

use core::{
    array::from_fn,
    cmp::Ordering,
    f64::consts::{FRAC_PI_2, PI},
    ops::{Add, Div, Mul, Neg, Sub},
};

use singletrack_control::Functions;

use super::vector_field::Clamp;

/// The bound of the relative error of a function of `libm`, which is of some 2e-16.
const FUNCTION_ERROR: f64 = 1e-14;

const ONE: Interval = Interval::exactly(1.0);

/// All numbers between two; not numbers if nothing is known. Every end is rounded outward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interval {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Interval {
    pub(super) const ZERO: Self = Self::exactly(0.0);
    pub(super) const UNKNOWN: Self = Self::exactly(f64::NAN);

    pub(super) const fn exactly(value: f64) -> Self {
        Self::between(value, value)
    }

    pub(super) const fn between(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// The largest modulus.
    fn most(self) -> f64 {
        self.high.max(-self.low)
    }

    /// The values of f(x)/x, which is even, one at zero, and falls with |x|.
    fn falling_ratio(self, function: impl Fn(f64) -> f64) -> Self {
        let ratio = |x: f64| if x == 0.0 { 1.0 } else { function(x) / x };
        let least = self.low.max(-self.high).max(0.0);
        // Not a number if an end is not.
        Self::of_values(
            ratio(self.most() + 0.0 * (self.low + self.high)),
            ratio(least),
        )
    }

    const fn outward(low: f64, high: f64) -> Self {
        Self::between(low.next_down(), high.next_up())
    }

    /// The interval of values of a function of `libm` at both ends.
    fn of_values(one: f64, other: f64) -> Self {
        if one.is_nan() || other.is_nan() {
            return Self::UNKNOWN;
        }
        let [low, high] = [one.min(other), one.max(other)];
        let more = FUNCTION_ERROR * (low.abs() + high.abs());
        Self::outward(low - more, high + more)
    }

    pub(super) fn middle(self) -> f64 {
        0.5 * (self.low + self.high)
    }

    pub(super) fn square(self) -> Self {
        let ends = self * self;
        let [low, high] = [self.low.abs(), self.high.abs()];
        let [least, most] = [low.min(high), low.max(high)];
        if ends.low.is_nan() {
            ends
        } else if self.low <= 0.0 && self.high >= 0.0 {
            Self::between(0.0, (most * most).next_up())
        } else {
            Self::outward(least * least, most * most)
        }
    }

    fn hull(self, other: Self) -> Self {
        // Not numbers stay so.
        let zero = 0.0 * (self.low + other.low + self.high + other.high);
        Self::between(
            self.low.min(other.low) + zero,
            self.high.max(other.high) + zero,
        )
    }

    fn cosine(self) -> Self {
        (self + Self::outward(FRAC_PI_2, FRAC_PI_2)).sine()
    }

    fn sine(self) -> Self {
        let ends = Self::of_values(self.low.sin(), self.high.sin());
        // Whether a crest, at π/2 and whole turns, may lie within, or a trough.
        let holds = |phase: f64| {
            let from = (self.low - 1e-9 - phase) / (2.0 * PI);
            let to = (self.high + 1e-9 - phase) / (2.0 * PI);
            from.ceil() <= to
        };
        Self::between(
            if holds(-FRAC_PI_2) { -1.0 } else { ends.low },
            if holds(FRAC_PI_2) { 1.0 } else { ends.high },
        )
    }
}

impl Neg for Interval {
    type Output = Self;
    fn neg(self) -> Self {
        Self::between(-self.high, -self.low)
    }
}

impl Add for Interval {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        // A sum that is zero is exact.
        let [low, high] = [self.low + other.low, self.high + other.high];
        Self {
            low: if low == 0.0 { low } else { low.next_down() },
            high: if high == 0.0 { high } else { high.next_up() },
        }
    }
}

impl Sub for Interval {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Interval {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let [a, b] = [self.low * other.low, self.low * other.high];
        let [c, d] = [self.high * other.low, self.high * other.high];
        // The least and the most pass over what is not a number.
        if (a + b + c + d).is_nan() {
            return Self::UNKNOWN;
        }
        if self == Self::ZERO || other == Self::ZERO {
            return Self::ZERO;
        }
        Self::outward(a.min(b).min(c.min(d)), a.max(b).max(c.max(d)))
    }
}

impl Div for Interval {
    type Output = Self;
    fn div(self, by: Self) -> Self {
        if by.low > 0.0 || by.high < 0.0 {
            self * Self::outward(1.0 / by.high, 1.0 / by.low)
        } else {
            Self::UNKNOWN
        }
    }
}

/// A function over a box of N coordinates: f(z) = f(0) + s z, with a row s of slopes.
///
/// Slopes are better than derivatives: they are those of chords from the origin, which a tyre
/// that saturates keeps positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chord<const N: usize> {
    /// The values of the function on the box.
    pub(super) value: Interval,
    /// Its value at the origin, which need not be in the box.
    pub(super) origin: Interval,
    pub(super) slopes: [Interval; N],
}

impl<const N: usize> Chord<N> {
    /// A function of this one, with its values on an interval and its slopes: those of all chords within
    /// an interval, which are its derivatives, or of those from zero.
    fn then(
        self,
        values: impl Fn(Interval) -> Interval,
        derivatives: impl Fn(Interval) -> Interval,
        from_zero: impl Fn(Interval) -> Interval,
    ) -> Self {
        let slope = if self.origin == Interval::ZERO {
            from_zero(self.value)
        } else {
            derivatives(self.value.hull(self.origin))
        };
        Self {
            value: values(self.value),
            origin: values(self.origin),
            slopes: self.slopes.map(|own| own * slope),
        }
    }

    pub(super) fn is_negative(&self) -> bool {
        self.value.high < 0.0
    }

    fn scaled(self, by: Interval) -> Self {
        Self {
            value: self.value * by,
            origin: self.origin * by,
            slopes: self.slopes.map(|slope| slope * by),
        }
    }
}

impl<const N: usize> From<f64> for Chord<N> {
    fn from(value: f64) -> Self {
        let value = Interval::exactly(value);
        Self {
            value,
            origin: value,
            // Not numbers if the value is not.
            slopes: [value * Interval::ZERO; N],
        }
    }
}

/// Only what is so for all values of both counts as less or greater.
impl<const N: usize> PartialOrd for Chord<N> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        if self.value.high < other.value.low {
            Some(Ordering::Less)
        } else if self.value.low > other.value.high {
            Some(Ordering::Greater)
        } else {
            None
        }
    }
}

impl<const N: usize> Neg for Chord<N> {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            value: -self.value,
            origin: -self.origin,
            slopes: self.slopes.map(|slope| -slope),
        }
    }
}

impl<const N: usize> Add for Chord<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            origin: self.origin + other.origin,
            slopes: from_fn(|index| self.slopes[index] + other.slopes[index]),
        }
    }
}

impl<const N: usize> Sub for Chord<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl<const N: usize> Mul for Chord<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            origin: self.origin * other.origin,
            slopes: from_fn(|index| {
                self.slopes[index] * other.origin + self.value * other.slopes[index]
            }),
        }
    }
}

impl<const N: usize> Div for Chord<N> {
    type Output = Self;
    fn div(self, by: Self) -> Self {
        let origin = self.origin / by.origin;
        Self {
            value: self.value / by.value,
            origin,
            slopes: from_fn(|index| (self.slopes[index] - origin * by.slopes[index]) / by.value),
        }
    }
}

impl<const N: usize> Mul<f64> for Chord<N> {
    type Output = Self;
    fn mul(self, by: f64) -> Self {
        self.scaled(Interval::exactly(by))
    }
}

impl<const N: usize> Div<f64> for Chord<N> {
    type Output = Self;
    fn div(self, by: f64) -> Self {
        self.scaled(Interval::exactly(1.0) / Interval::exactly(by))
    }
}

/// The elementary functions of chords from zero.
pub(super) enum ChordFunctions {}

impl<const N: usize> Functions<Chord<N>> for ChordFunctions {
    fn sin_cos(angle: Chord<N>) -> (Chord<N>, Chord<N>) {
        let sine = angle.then(Interval::sine, Interval::cosine, |x| {
            if x.most() < 4.4 {
                x.falling_ratio(f64::sin)
            } else {
                Interval::between(-0.22, 1.0)
            }
        });
        let cosine = angle.then(
            Interval::cosine,
            |x| -x.sine(),
            |x| {
                let ratio = |x: f64| {
                    if x == 0.0 {
                        0.0
                    } else {
                        -2.0 * (0.5 * x).sin().powi(2) / x
                    }
                };
                // It falls up to here, and is nowhere beyond ±0.73.
                if x.most() < 2.3 {
                    Interval::of_values(ratio(x.high), ratio(x.low))
                } else {
                    Interval::between(-0.73, 0.73)
                }
            },
        );
        (sine, cosine)
    }

    fn tanh(x: Chord<N>) -> Chord<N> {
        let tanh = |x: Interval| Interval::of_values(x.low.tanh(), x.high.tanh());
        x.then(
            tanh,
            |x| ONE - tanh(x).square(),
            |x| x.falling_ratio(f64::tanh),
        )
    }

    /// The angle of points whose x is above zero; unknown for others.
    fn atan2(y: Chord<N>, x: Chord<N>) -> Chord<N> {
        if x.value.low > 0.0 {
            (y / x).then(
                |x| Interval::of_values(x.low.atan(), x.high.atan()),
                |x| ONE / (ONE + x.square()),
                |x| x.falling_ratio(f64::atan),
            )
        } else {
            Chord::from(f64::NAN)
        }
    }
}

impl<const N: usize> Clamp<Chord<N>> for ChordFunctions {
    fn clamped(x: Chord<N>, most: f64) -> Chord<N> {
        x.then(
            |x| Interval::between(x.low.clamp(-most, most), x.high.clamp(-most, most)),
            |x| {
                if x.most() <= most {
                    ONE
                } else {
                    Interval::between(0.0, 1.0)
                }
            },
            |x| x.falling_ratio(|x| x.min(most)),
        )
    }
}
