//! Can the car stop inside? How long the way of a stop is, and where it leads.
//!
//! A stop begins a reaction time t after it is decided, and slows down with the constant
//! deceleration a: from the speed v its way is |v| t + v²/(2a), and so the car can stop within a
//! way s from a (√(t² + 2s/a) - t). A stop holds the wheels: a car that rolls goes along one bend,
//! whose curvature is κ. After a part w of the way its course has turned by κ w, and the chord to
//! there is w sin(κw/2)/(κw/2) long and lies half of that turn beside the first course. The path
//! is looked at half way and at its end: it lies at most κ w²/32 beside the chords of both halves.
//!
//! Four ask, each with a speed and a bend of its own:
//!
//! | who asks | speed, bend | what follows if it can't |
//! |---|---|---|
//! | feasibility, before a drive | those of an ideal car | the drive does not begin |
//! | the [`Governor`](crate::Governor), ahead | those of the leader on the reference | the reference is slowed down |
//! | the [`SafetyFilter`](crate::SafetyFilter), each tick | every one that is possible: [`StopWay`] bounds them all | the command is limited |
//! | the geofence's watch, each tick | the measured and the commanded | the car stops |

use core::f64::consts::FRAC_PI_2;

use libm::{fabs, sincos, sqrt};

use crate::{Position, Side, Velocity, direction};

/// The way is judged in so many pieces; more are less cautious.
const PIECES: usize = 12;

/// More than the part of a number that the operations between two uses of this round away: each
/// half of `EPSILON`, a sine or cosine one.
pub(crate) const ROUNDED: f64 = 16.0 * f64::EPSILON;

/// How the car stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// The time before it slows down, s.
    pub reaction: f64,
    /// The deceleration then, m/s².
    pub braking: f64,
}

impl Stop {
    /// The way to standstill from a speed in either direction (m/s), in m.
    pub const fn way(&self, speed: f64) -> f64 {
        let pace = speed.abs();
        pace * self.reaction + 0.5 * pace * pace / self.braking
    }

    /// The speed from which the car stands within a way of `way` m, in m/s; 0 if that is NaN or
    /// negative.
    pub fn fastest(&self, way: f64) -> f64 {
        if way.is_nan() || way <= 0.0 {
            return 0.0;
        }
        let Self { reaction, braking } = *self;
        braking * (sqrt(reaction * reaction + 2.0 * way / braking) - reaction)
    }
}

/// Where a way of `way` m along a bend (1/m, positive to the left) leads, in m: half of it and all
/// of it. `course` is the unit vector of the motion, for a negative way that of the motion forward.
pub fn along_bend(course: &Velocity, curvature: f64, way: f64) -> [Velocity; 2] {
    [0.5 * way, way].map(|way| {
        // Beyond half of a circle it comes back.
        let turn = (0.5 * curvature * way).clamp(-FRAC_PI_2, FRAC_PI_2);
        let (sine, cosine) = sincos(turn);
        let turned = Velocity::new(
            cosine * course.x - sine * course.y,
            sine * course.x + cosine * course.y,
        );
        let part = if fabs(turn) < 1e-6 { 1.0 } else { sine / turn };
        way * (part * turned)
    })
}

/// A range of curvatures (1/m) or angles (rad); positive to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    pub(crate) least: f64,
    pub(crate) most: f64,
}

impl Range {
    pub(crate) const fn only(value: f64) -> Self {
        Self {
            least: value,
            most: value,
        }
    }

    pub(crate) const fn with(self, value: f64) -> Self {
        Self {
            least: self.least.min(value),
            most: self.most.max(value),
        }
    }

    /// The range of a function that rises.
    pub(crate) fn map(self, function: impl Fn(f64) -> f64) -> Self {
        Self {
            least: function(self.least),
            most: function(self.most),
        }
    }

    /// The range on the other side.
    pub(crate) const fn mirrored(self) -> Self {
        Self {
            least: -self.most,
            most: -self.least,
        }
    }

    pub(crate) const fn widened(self, by: f64) -> Self {
        Self {
            least: self.least - by,
            most: self.most + by,
        }
    }
}

/// How the wheels may stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wheels {
    /// The change of the heading for each metre of the way, rad/m.
    pub(crate) curvatures: Range,
    /// The angle from the heading to the direction of motion, rad.
    pub(crate) sideslips: Range,
}

/// Every way that a stopping car may take from where it is. Whether they stay inside an area is judged
/// in the arithmetic that runs: everything is rounded to the side of caution, by more than its
/// operations can have rounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StopWay {
    pub(crate) from: Position,
    /// The heading: the yaw of a car that goes forward, rad.
    pub(crate) heading: f64,
    /// The length, m.
    pub(crate) length: f64,
    /// What is possible until the wheels have settled.
    pub(crate) first: Wheels,
    /// The way that this takes, m.
    pub(crate) settles_after: f64,
    /// What is possible then.
    pub(crate) then: Wheels,
}

impl StopWay {
    /// Whether all of them keep `margin` (m) from every side. False if a number is not finite.
    ///
    /// The heading at each distance lies between those of the least and of the most curvature,
    /// and the course differs from it by the sideslip. Over a piece, the motion towards a side is
    /// bounded by that of the worst course in it. So no way comes nearer to the side than the sum
    /// of the pieces.
    pub(crate) fn stays_inside<'a>(
        &self,
        sides: impl IntoIterator<Item = &'a Side>,
        margin: f64,
    ) -> bool {
        let (piece, cones) = self.cones();
        sides.into_iter().all(|side| {
            let mut distances = self.distances(side, margin, piece, &cones);
            // Not `< 0`: NaN is not inside.
            distances.all(|distance| distance >= 0.0)
        })
    }

    /// How far from a line with this normal all of them must begin at least to keep `margin` (m) from
    /// it, m.
    pub(crate) fn room(&self, outward: &Velocity, margin: f64) -> f64 {
        let (piece, cones) = self.cones();
        let side = Side {
            outward: *outward,
            offset: outward.dot(&self.from.coords),
        };
        let nearest = self.distances(&side, margin, piece, &cones);
        -nearest.fold(f64::INFINITY, f64::min)
    }

    /// The least distances from a side after each piece, m, less a margin; the first one is that at
    /// the beginning.
    fn distances<'a>(
        &self,
        side: &Side,
        margin: f64,
        piece: f64,
        cones: &'a [Cone; PIECES],
    ) -> impl Iterator<Item = f64> + use<'a> {
        let from = &self.from;
        let terms = fabs(side.offset) + fabs(from.x) + fabs(from.y) + margin;
        let first = side.distance(from) - margin - ROUNDED * terms;
        let (outward, mut cones) = (side.outward, cones.iter());
        core::iter::successors(Some(first), move |distance| {
            let along = piece * cones.next()?.most_along(&outward);
            Some(distance - along - ROUNDED * (fabs(*distance) + piece))
        })
    }

    /// The length of a piece, and the directions between which the motion lies in each.
    fn cones(&self) -> (f64, [Cone; PIECES]) {
        let piece = self.length / PIECES as f64 * (1.0 + ROUNDED);
        let (mut right, mut left) = (self.heading, self.heading);
        let cones = core::array::from_fn(|index| {
            let wheels = if (index as f64) * piece < self.settles_after {
                &self.first
            } else {
                &self.then
            };
            let (turn_right, turn_left) = (
                wheels.curvatures.least * piece,
                wheels.curvatures.most * piece,
            );
            let rounded = |heading: f64, turn: f64| ROUNDED * (fabs(heading) + fabs(turn));
            let (to_right, to_left) = (
                right + turn_right - rounded(right, turn_right),
                left + turn_left + rounded(left, turn_left),
            );
            let Range { least, most } = wheels.sideslips;
            let (furthest_right, furthest_left) = (right.min(to_right), left.max(to_left));
            let cone = Cone::new(
                furthest_right + least - rounded(furthest_right, least),
                furthest_left + most + rounded(furthest_left, most),
            );
            (right, left) = (to_right, to_left);
            cone
        });
        (piece, cones)
    }
}

/// The directions between two angles.
struct Cone {
    right: Velocity,
    left: Velocity,
    /// The cosine of half the opening, and the middle.
    half: f64,
    middle: Velocity,
}

impl Cone {
    fn new(right: f64, left: f64) -> Self {
        let half = 0.5 * (left - right);
        Self {
            right: direction(right),
            left: direction(left),
            half: if half < core::f64::consts::PI {
                libm::cos(half) - ROUNDED
            } else {
                // Every direction; and so for NaN.
                -1.0
            },
            middle: direction(0.5 * (right + left)),
        }
    }

    /// The largest component along `outward` of a unit vector in the cone, but for [`ROUNDED`].
    fn most_along(&self, outward: &Velocity) -> f64 {
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
    use std::{vec, vec::Vec};

    use proptest::prelude::*;

    use super::*;
    use crate::ConvexArea;

    const STOP: Stop = Stop {
        reaction: 0.1,
        braking: 1.5,
    };

    #[test]
    fn the_fastest_speed_of_a_way_is_that_whose_way_it_is() {
        for speed in [0.01, 0.4, 3.0] {
            assert!((STOP.fastest(STOP.way(speed)) - speed).abs() < 1e-12);
            assert_eq!(STOP.way(-speed), STOP.way(speed));
        }
        for way in [f64::NAN, -1.0, 0.0] {
            assert_eq!(STOP.fastest(way), 0.0);
        }
    }

    #[test]
    fn a_way_along_a_bend_ends_on_its_circle() {
        let course = direction(0.3);
        for (curvature, way) in [
            (0.5, 1.0),
            (-2.0, 0.7),
            (1e-9, 1.0),
            (0.0, 1.0),
            (2.0, -0.4),
        ] {
            let [half, whole] = along_bend(&course, curvature, way);
            let straight = way * course;
            if curvature.abs() < 1e-6 {
                assert!((half - 0.5 * straight).norm() + (whole - straight).norm() < 1e-8);
                continue;
            }
            let centre = Velocity::new(-course.y, course.x) / curvature;
            for place in [half, whole] {
                let radius = (place - centre).norm();
                assert!((radius - 1.0 / curvature.abs()).abs() < 1e-12);
            }
            let turned = (course.perp(&(whole - half))).signum();
            assert_eq!(turned, curvature.signum());
        }
    }

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
        assert!(straight(from, 0.0, 0.8 - 1e-9).stays_inside(square().sides(), 0.0));
        assert!(!straight(from, 0.0, 0.8 + 1e-9).stays_inside(square().sides(), 0.0));
        assert!(!straight(from, 0.0, 0.75).stays_inside(square().sides(), 0.1));
        assert!(straight(from, core::f64::consts::PI, 1.1).stays_inside(square().sides(), 0.0));
    }

    #[test]
    fn numbers_that_are_none_stay_nowhere() {
        let from = Position::new(f64::NAN, 0.0);
        assert!(!straight(from, 0.0, 0.1).stays_inside(square().sides(), 0.0));
        assert!(!straight(Position::origin(), f64::NAN, 0.1).stays_inside(square().sides(), 0.0));
        assert!(!straight(Position::origin(), 0.0, f64::NAN).stays_inside(square().sides(), 0.0));
        assert!(
            !straight(Position::origin(), 0.0, f64::INFINITY).stays_inside(square().sides(), 0.0)
        );
    }

    /// An interval that holds the real number: every end is rounded outward.
    #[derive(Clone, Copy, Debug)]
    struct Interval {
        low: f64,
        high: f64,
    }

    impl Interval {
        const fn exactly(value: f64) -> Self {
            Self {
                low: value,
                high: value,
            }
        }

        const fn outward(low: f64, high: f64) -> Self {
            Self {
                low: low.next_down(),
                high: high.next_up(),
            }
        }

        fn plus(self, other: Self) -> Self {
            Self::outward(self.low + other.low, self.high + other.high)
        }

        fn minus(self, other: Self) -> Self {
            Self::outward(self.low - other.high, self.high - other.low)
        }

        fn times(self, other: Self) -> Self {
            let ends = [
                self.low * other.low,
                self.low * other.high,
                self.high * other.low,
                self.high * other.high,
            ];
            let low = ends.into_iter().fold(f64::INFINITY, f64::min);
            Self::outward(low, ends.into_iter().fold(f64::NEG_INFINITY, f64::max))
        }

        /// The largest cosine of the angles between these, less that of `of`: 1 if it is among them.
        /// The cosine of libm is within one unit of the last place, taken as two of 1.
        fn most_cosine(right: Self, left: Self, of: f64) -> Self {
            let turn = core::f64::consts::TAU;
            // The turn nearest before the left end at which the outward direction lies.
            let turns = libm::floor((left.high - of) / turn);
            let along = of + turns * turn;
            let slack = 1e-12 * (1.0 + libm::fabs(left.high));
            if along > right.high + slack && along < left.low - slack {
                return Self::exactly(1.0);
            }
            let may_be_among = along >= right.low - slack && along <= left.high + slack;
            let cosine = |angle: Self| {
                let difference = angle.minus(Self::exactly(of));
                let (one, other) = (libm::cos(difference.low), libm::cos(difference.high));
                // Between the ends it is above neither by more than the square of their distance.
                let width = difference.high - difference.low;
                let more = width * width + 2.0 * f64::EPSILON;
                Self::outward(one.min(other) - more, one.max(other) + more)
            };
            let (right, left) = (cosine(right), cosine(left));
            Self {
                low: right.low.max(left.low),
                // Near the outward direction it may be among them.
                high: if may_be_among {
                    1.0
                } else {
                    right.high.max(left.high)
                },
            }
        }
    }

    /// The distances to a side in real numbers, for comparison: `outward` is the angle of the
    /// normal.
    fn real_distances(way: &StopWay, outward: f64, offset: f64, margin: f64) -> Vec<Interval> {
        let exactly = Interval::exactly;
        let piece = exactly(way.length / PIECES as f64 * (1.0 + ROUNDED));
        let normal = [libm::cos(outward), libm::sin(outward)].map(exactly);
        let [along_x, along_y] = [
            normal[0].times(exactly(way.from.x)),
            normal[1].times(exactly(way.from.y)),
        ];
        let mut distance = exactly(offset).minus(along_x).minus(along_y);
        distance = distance.minus(exactly(margin));
        let mut distances = vec![distance];
        let (mut right, mut left) = (exactly(way.heading), exactly(way.heading));
        for index in 0..PIECES {
            let wheels = if (index as f64) * piece.low < way.settles_after {
                &way.first
            } else {
                &way.then
            };
            let to_right = right.plus(exactly(wheels.curvatures.least).times(piece));
            let to_left = left.plus(exactly(wheels.curvatures.most).times(piece));
            let least = |one: Interval, other: Interval| Interval {
                low: one.low.min(other.low),
                high: one.high.min(other.high),
            };
            let most = |one: Interval, other: Interval| Interval {
                low: one.low.max(other.low),
                high: one.high.max(other.high),
            };
            let from = least(right, to_right).plus(exactly(wheels.sideslips.least));
            let to = most(left, to_left).plus(exactly(wheels.sideslips.most));
            let along = Interval::most_cosine(from, to, outward);
            distance = distance.minus(piece.times(along));
            distances.push(distance);
            (right, left) = (to_right, to_left);
        }
        distances
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        /// Outward-rounded intervals hold the real distances: what is judged is never above them,
        /// and below by less than ten nanometres.
        #[test]
        fn the_arithmetic_that_runs_errs_to_the_side_of_caution(
            x in -100.0..100.0,
            y in -100.0..100.0,
            heading in -1_000.0..1_000.0,
            length in 0.0..50.0,
            least in -8.0..8.0,
            width in 0.0..4.0,
            slips in (-0.6..0.1, 0.0..0.6),
            settles_after in 0.0..10.0,
            // Also the exact directions of the sides.
            outward in prop_oneof![-4.0..4.0, Just(0.0), Just(core::f64::consts::FRAC_PI_2)],
            offset in -100.0..200.0,
            margin in 0.0..0.1,
        ) {
            let curvatures = Range { least, most: least + width };
            let sideslips = Range { least: slips.0, most: slips.0 + slips.1 };
            let way = StopWay {
                from: Position::new(x, y),
                heading,
                length,
                first: Wheels { curvatures, sideslips },
                settles_after,
                then: Wheels { curvatures: Range::only(least), sideslips },
            };
            let side = Side { outward: direction(outward), offset };
            let (piece, cones) = way.cones();
            let judged: Vec<f64> = way.distances(&side, margin, piece, &cones).collect();
            let real = real_distances(&way, outward, offset, margin);
            prop_assert_eq!(judged.len(), real.len());
            for (judged, real) in judged.into_iter().zip(real) {
                // An interval about zero is no narrower.
                prop_assert!(judged <= real.low + f64::MIN_POSITIVE, "{judged} of {real:?}");
                prop_assert!(real.high - judged < 1e-8, "{judged} of {real:?}");
            }
        }
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
            let inside = way.stays_inside(square().sides(), 0.0);
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
