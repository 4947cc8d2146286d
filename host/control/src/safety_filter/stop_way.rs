//! Whether every way to standstill stays inside an area.

use crate::{ConvexArea, Position, direction};

/// The way is judged in so many pieces; more are less cautious.
const PIECES: usize = 12;

/// A range of curvatures (1/m) or angles (rad); positive to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) least: f64,
    pub(super) most: f64,
}

impl Range {
    pub(super) const fn only(value: f64) -> Self {
        Self {
            least: value,
            most: value,
        }
    }

    pub(super) const fn with(self, value: f64) -> Self {
        Self {
            least: self.least.min(value),
            most: self.most.max(value),
        }
    }

    /// The range on the other side.
    pub(super) const fn mirrored(self) -> Self {
        Self {
            least: -self.most,
            most: -self.least,
        }
    }

    pub(super) const fn widened(self, by: f64) -> Self {
        Self {
            least: self.least - by,
            most: self.most + by,
        }
    }
}

/// How the wheels may stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wheels {
    /// The change of the heading for each metre of the way, rad/m.
    pub(super) curvatures: Range,
    /// The angle from the heading to the direction of motion, rad.
    pub(super) sideslips: Range,
}

/// Every way that a stopping car may take from where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StopWay {
    pub(super) from: Position,
    /// The heading: the yaw of a car that goes forward, rad.
    pub(super) heading: f64,
    /// The length, m.
    pub(super) length: f64,
    /// What is possible until the wheels have settled.
    pub(super) first: Wheels,
    /// The way that this takes, m.
    pub(super) settles_after: f64,
    /// What is possible then.
    pub(super) then: Wheels,
}

impl StopWay {
    /// Whether all of them keep `margin` (m) from every side of `area`. False if a number is
    /// not finite.
    ///
    /// The heading at each distance lies between those of the least and of the most curvature,
    /// and the course differs from it by the sideslip. Over a piece, the motion towards a side is
    /// bounded by that of the worst course in it. So no way comes nearer to the side than the sum
    /// of the pieces.
    pub(super) fn stays_inside(&self, area: &ConvexArea, margin: f64) -> bool {
        let piece = self.length / PIECES as f64;
        let (mut right, mut left) = (self.heading, self.heading);
        // The directions between which the motion lies, in each piece.
        let cones: [Cone; PIECES] = core::array::from_fn(|index| {
            let wheels = if (index as f64) * piece < self.settles_after {
                &self.first
            } else {
                &self.then
            };
            let (to_right, to_left) = (
                right + wheels.curvatures.least * piece,
                left + wheels.curvatures.most * piece,
            );
            let cone = Cone::new(
                right.min(to_right) + wheels.sideslips.least,
                left.max(to_left) + wheels.sideslips.most,
            );
            (right, left) = (to_right, to_left);
            cone
        });
        area.sides().iter().all(|side| {
            let mut distance = side.distance(&self.from) - margin;
            // Not `< 0`: NaN is not inside.
            distance >= 0.0
                && cones.iter().all(|cone| {
                    distance -= piece * cone.most_along(&side.outward);
                    distance >= 0.0
                })
        })
    }
}

/// The directions between two angles.
struct Cone {
    right: crate::Velocity,
    left: crate::Velocity,
    /// The cosine of half the opening, and the middle.
    half: f64,
    middle: crate::Velocity,
}

impl Cone {
    fn new(right: f64, left: f64) -> Self {
        let half = 0.5 * (left - right);
        Self {
            right: direction(right),
            left: direction(left),
            half: if half < core::f64::consts::PI {
                libm::cos(half)
            } else {
                // Every direction; and so for NaN.
                -1.0
            },
            middle: direction(0.5 * (right + left)),
        }
    }

    /// The largest component along `outward` of a unit vector in the cone.
    fn most_along(&self, outward: &crate::Velocity) -> f64 {
        if self.middle.dot(outward) >= self.half {
            1.0
        } else {
            self.right.dot(outward).max(self.left.dot(outward))
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn square() -> ConvexArea {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap()
    }

    fn straight(from: Position, course: f64, length: f64) -> StopWay {
        let wheels = Wheels {
            curvatures: Range::only(0.0),
            sideslips: Range::only(0.0),
        };
        StopWay {
            from,
            heading: course,
            length,
            first: wheels,
            settles_after: 0.0,
            then: wheels,
        }
    }

    #[test]
    fn a_straight_way_reaches_exactly_as_far_as_it_is_long() {
        let from = Position::new(0.2, 0.0);
        assert!(straight(from, 0.0, 0.8 - 1e-9).stays_inside(&square(), 0.0));
        assert!(!straight(from, 0.0, 0.8 + 1e-9).stays_inside(&square(), 0.0));
        assert!(!straight(from, 0.0, 0.75).stays_inside(&square(), 0.1));
        assert!(straight(from, core::f64::consts::PI, 1.1).stays_inside(&square(), 0.0));
    }

    #[test]
    fn numbers_that_are_none_stay_nowhere() {
        let from = Position::new(f64::NAN, 0.0);
        assert!(!straight(from, 0.0, 0.1).stays_inside(&square(), 0.0));
        assert!(!straight(Position::origin(), f64::NAN, 0.1).stays_inside(&square(), 0.0));
        assert!(!straight(Position::origin(), 0.0, f64::NAN).stays_inside(&square(), 0.0));
        assert!(!straight(Position::origin(), 0.0, f64::INFINITY).stays_inside(&square(), 0.0));
    }

    proptest! {
        /// Ways whose curvature jumps about within its range: where one leaves, the judgement
        /// has said so.
        #[test]
        fn a_way_within_the_ranges_never_leaves_what_was_judged_to_hold_it(
            x in -0.9..0.9,
            y in -0.9..0.9,
            course in -4.0..4.0,
            length in 0.0..1.5,
            least in -3.0..3.0,
            width in 0.0..2.0,
            settles_after in 0.0..1.0,
            shares in proptest::collection::vec(0.0..1.0, 40),
            slips in proptest::collection::vec(-0.3..0.1, 40),
        ) {
            let first = Wheels {
                curvatures: Range { least, most: least + width },
                sideslips: Range { least: -0.3, most: 0.1 },
            };
            let then = Wheels {
                curvatures: Range::only(least).widened(0.1),
                ..first
            };
            let way = StopWay {
                from: Position::new(x, y),
                heading: course,
                length,
                first,
                settles_after,
                then,
            };
            let inside = way.stays_inside(&square(), 0.0);
            let (mut at, mut heading) = (way.from, course);
            let fine = 400;
            let step: f64 = length / f64::from(fine);
            let mut left = false;
            for index in 0..fine {
                let wheels = if f64::from(index) * step < settles_after { first } else { then };
                let range = wheels.curvatures;
                let share: f64 = shares[(index / 10) as usize];
                let curvature = range.least + share * (range.most - range.least);
                heading += 0.5 * curvature * step;
                let slip: f64 = slips[(index / 10) as usize];
                at += direction(heading + slip) * step;
                heading += 0.5 * curvature * step;
                left |= square().clearance(&at) < -1e-6;
            }
            prop_assert!(!(inside && left));
        }
    }
}
