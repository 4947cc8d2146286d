//! A convex polygon on the floor: where a point may be, and the nearest place inside.

use heapless::Vec;
use libm::sqrt;

use crate::{Position, Velocity};

/// The most corners of a [`ConvexArea`].
pub const MAX_AREA_CORNERS: usize = 16;

/// Corners closer than this are one, m.
const SAME: f64 = 1e-9;

/// Why corners are not a convex area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AreaError {
    /// Fewer than 3 corners, or more than [`MAX_AREA_CORNERS`].
    #[error("{0} corners: give 3 to {MAX_AREA_CORNERS}, in order")]
    Corners(usize),
    /// A coordinate is infinite or NaN.
    #[error("corner {0} is not finite")]
    NotFinite(usize),
    /// The polygon has an angle of 180 degrees or more, no area, or sides that cross.
    #[error("the polygon is not convex at corner {0}")]
    NotConvex(usize),
    /// Nothing is left between the sides.
    #[error("nothing is left of the area within this margin")]
    Empty,
}

/// A side: the points x with `outward`·x <= `offset` lie within.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Side {
    /// The unit vector that leads out.
    pub outward: Velocity,
    /// Its largest product with a point of the area, in m.
    pub offset: f64,
}

impl Side {
    /// The distance of `point` from the side, in m; negative beyond it.
    pub fn distance(&self, point: &Position) -> f64 {
        self.offset - self.outward.dot(&point.coords)
    }
}

/// A convex polygon.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexArea {
    /// Counter-clockwise.
    corners: Vec<Position, MAX_AREA_CORNERS>,
    /// Side `i` begins at corner `i`.
    sides: Vec<Side, MAX_AREA_CORNERS>,
}

impl ConvexArea {
    /// The area with these corners in order, in either direction (m).
    ///
    /// # Errors
    ///
    /// See [`AreaError`].
    pub fn new(corners: &[Position]) -> Result<Self, AreaError> {
        let count = corners.len();
        let mut corners: Vec<Position, MAX_AREA_CORNERS> =
            Vec::from_slice(corners).map_err(|_| AreaError::Corners(count))?;
        if count < 3 {
            return Err(AreaError::Corners(count));
        }
        let finite = |corner: &Position| corner.iter().all(|number| number.is_finite());
        if let Some(index) = corners.iter().position(|corner| !finite(corner)) {
            return Err(AreaError::NotFinite(index));
        }
        let next = |index: usize| &corners[(index + 1) % count].coords;
        let triangles = (0..count).map(|index| corners[index].coords.perp(next(index)));
        let area: f64 = triangles.sum();
        if area < 0.0 {
            corners.reverse();
        }
        let side = |index: usize| corners[(index + 1) % count] - corners[index % count];
        let mut turned = 0.0;
        for index in 0..count {
            let (one, next) = (side(index), side(index + 1));
            let bend = one.perp(&next);
            if bend.is_nan() || bend <= 0.0 {
                return Err(AreaError::NotConvex((index + 1) % count));
            }
            turned += crate::angle_between(&one, &next);
        }
        // A pentagram turns left at every corner too, but twice around.
        if turned > 1.5 * core::f64::consts::TAU {
            return Err(AreaError::NotConvex(0));
        }
        let sides = (0..count)
            .map(|index| {
                let along = side(index);
                let outward = Velocity::new(along.y, -along.x) / sqrt(along.norm_squared());
                Side {
                    outward,
                    offset: outward.dot(&corners[index].coords),
                }
            })
            .collect();
        Ok(Self { corners, sides })
    }

    /// The part of the area that keeps at least `margin` (m) from every side.
    ///
    /// # Errors
    ///
    /// [`AreaError::Empty`] if there is none.
    pub fn shrunk(&self, margin: f64) -> Result<Self, AreaError> {
        // A cut adds one corner at most.
        let mut left: Vec<Position, { 2 * MAX_AREA_CORNERS }> =
            Vec::from_slice(&self.corners).map_err(|_| AreaError::Empty)?;
        for side in &self.sides {
            let side = Side {
                offset: side.offset - margin,
                ..*side
            };
            let mut kept = Vec::<Position, { 2 * MAX_AREA_CORNERS }>::new();
            for index in 0..left.len() {
                let (from, to) = (left[index], left[(index + 1) % left.len()]);
                let (here, there) = (side.distance(&from), side.distance(&to));
                if here >= 0.0 {
                    kept.push(from).map_err(|_| AreaError::Empty)?;
                }
                if (here < 0.0) != (there < 0.0) {
                    let crossing = from + (to - from) * (here / (here - there));
                    kept.push(crossing).map_err(|_| AreaError::Empty)?;
                }
            }
            left = kept;
        }
        // Cuts through one point leave corners upon each other.
        let mut corners = Vec::<Position, { 2 * MAX_AREA_CORNERS }>::new();
        for index in 0..left.len() {
            let next = left[(index + 1) % left.len()];
            if (next - left[index]).amax() > SAME {
                corners.push(next).map_err(|_| AreaError::Empty)?;
            }
        }
        Self::new(&corners).map_err(|_| AreaError::Empty)
    }

    /// The corners, counter-clockwise, in m.
    pub fn corners(&self) -> &[Position] {
        &self.corners
    }

    /// The sides.
    pub fn sides(&self) -> &[Side] {
        &self.sides
    }

    /// The distance from `point` to the nearest side's line, in m; negative outside. NaN is
    /// outside.
    pub fn clearance(&self, point: &Position) -> f64 {
        let least = self
            .sides
            .iter()
            .map(|side| side.distance(point))
            .fold(f64::INFINITY, f64::min);
        if point.x.is_finite() && point.y.is_finite() {
            least
        } else {
            f64::NEG_INFINITY
        }
    }

    /// The point of the area that is nearest to `point`.
    pub fn nearest(&self, point: &Position) -> Position {
        if self.sides.iter().all(|side| side.distance(point) >= 0.0) {
            return *point;
        }
        let count = self.corners.len();
        let mut best = (f64::INFINITY, *point);
        for index in 0..count {
            let from = self.corners[index];
            let along = self.corners[(index + 1) % count] - from;
            let share = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            let candidate = from + along * share;
            let distance = (candidate - point).norm_squared();
            if distance < best.0 {
                best = (distance, candidate);
            }
        }
        best.1
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn area(corners: &[(f64, f64)]) -> Result<ConvexArea, AreaError> {
        let corners: std::vec::Vec<_> =
            corners.iter().map(|(x, y)| Position::new(*x, *y)).collect();
        ConvexArea::new(&corners)
    }

    fn carpet() -> ConvexArea {
        area(&[(-2.0, -1.0), (2.0, -1.0), (2.0, 1.0), (-2.0, 1.0)]).unwrap()
    }

    #[test]
    fn either_direction_of_the_corners_is_the_same_area() {
        let other = area(&[(-2.0, 1.0), (2.0, 1.0), (2.0, -1.0), (-2.0, -1.0)]).unwrap();
        for (x, y, clearance) in [(0.0, 0.0, 1.0), (1.5, 0.0, 0.5), (0.0, 1.5, -0.5)] {
            let point = Position::new(x, y);
            assert_eq!(carpet().clearance(&point), clearance);
            assert_eq!(other.clearance(&point), clearance);
        }
        assert!(carpet().clearance(&Position::new(f64::NAN, 0.0)) < 0.0);
    }

    #[test]
    fn what_is_not_a_convex_polygon_is_refused() {
        assert_eq!(area(&[(0.0, 0.0), (1.0, 0.0)]), Err(AreaError::Corners(2)));
        assert_eq!(
            area(&[(0.0, 0.0), (1.0, f64::NAN), (1.0, 1.0)]),
            Err(AreaError::NotFinite(1))
        );
        for shape in [
            // An L, a line, a bow, and a pentagram.
            &[
                (0.0, 0.0),
                (2.0, 0.0),
                (2.0, 1.0),
                (1.0, 1.0),
                (1.0, 2.0),
                (0.0, 2.0),
            ][..],
            &[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)],
            &[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)],
            &[
                (0.0, 1.0),
                (-0.6, -0.8),
                (0.95, 0.3),
                (-0.95, 0.3),
                (0.6, -0.8),
            ],
        ] {
            assert!(matches!(area(shape), Err(AreaError::NotConvex(_))));
        }
    }

    #[test]
    fn a_margin_moves_every_side_and_drops_those_that_vanish() {
        let shrunk = carpet().shrunk(0.4).unwrap();
        assert_eq!(shrunk.corners().len(), 4);
        assert!((shrunk.clearance(&Position::origin()) - 0.6).abs() < 1e-12);
        assert_eq!(carpet().shrunk(1.1), Err(AreaError::Empty));
        // A corner that is cut off by 0.1 m is no side any more.
        let cut = area(&[(0.0, 0.0), (3.0, 0.0), (3.0, 2.9), (2.9, 3.0), (0.0, 3.0)]).unwrap();
        assert_eq!(cut.sides().len(), 5);
        assert_eq!(cut.shrunk(0.5).unwrap().sides().len(), 4);
    }

    proptest! {
        #[test]
        fn the_nearest_point_is_inside_and_no_corner_or_side_is_nearer(
            x in -5.0..5.0,
            y in -5.0..5.0,
            along in 0.0..1.0_f64,
        ) {
            let shape =
                area(&[(0.0, -1.0), (2.0, -0.5), (2.5, 1.0), (0.5, 2.0), (-1.0, 0.0)]).unwrap();
            let point = Position::new(x, y);
            let nearest = shape.nearest(&point);
            prop_assert!(shape.clearance(&nearest) > -1e-12);
            let distance = (nearest - point).norm();
            for index in 0..5 {
                let (from, to) = (shape.corners()[index], shape.corners()[(index + 1) % 5]);
                let other: Position = from + (to - from) * along;
                prop_assert!((other - point).norm() >= distance - 1e-12);
            }
        }
    }
}
