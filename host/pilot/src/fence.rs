//! The geofence: the polygon on the floor that the car must not leave.

use heapless::Vec;
use libm::{fabs, sqrt};
use singletrack_control::{Position, Velocity};

/// The most corners that a geofence can have.
pub const MAX_FENCE_CORNERS: usize = 16;

/// Why corners and margin are not a geofence.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FenceError {
    /// How many corners there are: fewer than 3, or more than [`MAX_FENCE_CORNERS`].
    #[error("{0} corners: give 3 to {MAX_FENCE_CORNERS}, in order")]
    Corners(usize),
    /// A corner, by its index from 0, whose x or y in m is infinite or NaN.
    #[error("corner {0} is ({1}, {2}): both must be finite")]
    NotFinite(usize, f64, f64),
    /// Two sides, by the indices of the corners where they begin, cross or touch.
    #[error(
        "the sides from corner {0} and from corner {1} meet: give the corners in order around the area"
    )]
    Crosses(usize, usize),
    /// The margin, in m, is negative, infinite or NaN.
    #[error("the margin is {0}: it must be finite and not negative")]
    Margin(f64),
}

/// A geofence: a polygon that the car's centre of mass must not leave, and must be
/// able to stop inside. World frame, in m.
#[derive(Clone, Debug, PartialEq)]
pub struct Fence {
    corners: Vec<Position, MAX_FENCE_CORNERS>,
    margin: f64,
}

impl Fence {
    /// A geofence with these corners in order, in either direction (m, world frame).
    /// The centre of mass keeps at least `margin` (m) from every side: half the car's
    /// length, for instance.
    ///
    /// # Errors
    ///
    /// The wrong number of corners, a value that is not finite, a negative margin, or
    /// sides that cross or touch.
    pub fn new(corners: &[Position], margin: f64) -> Result<Self, FenceError> {
        if !(margin.is_finite() && margin >= 0.0) {
            return Err(FenceError::Margin(margin));
        }
        let count = corners.len();
        let corners = Vec::from_slice(corners).map_err(|_| FenceError::Corners(count))?;
        if count < 3 {
            return Err(FenceError::Corners(count));
        }
        for (index, corner) in corners.iter().enumerate() {
            if !(corner.x.is_finite() && corner.y.is_finite()) {
                return Err(FenceError::NotFinite(index, corner.x, corner.y));
            }
        }
        let fence = Self { corners, margin };
        fence.check_sides()?;
        Ok(fence)
    }

    /// The corners, in the order given (m, world frame).
    pub fn corners(&self) -> &[Position] {
        &self.corners
    }

    /// The distance that the centre of mass keeps from every side, in m.
    pub const fn margin(&self) -> f64 {
        self.margin
    }

    /// The distance from `point` to the nearest side minus the margin, in m; negative
    /// outside and inside the margin.
    pub fn clearance(&self, point: &Position) -> f64 {
        let squared = self
            .sides()
            .map(|(_, from, to)| squared_distance_to_side(point, &from, &to))
            .fold(f64::INFINITY, f64::min);
        let distance = sqrt(squared);
        let inside = if self.encloses(point) {
            distance
        } else {
            -distance
        };
        inside - self.margin
    }

    /// Whether the straight path from `point` by `way` (m) stays inside: both ends keep
    /// the margin, and the path crosses no side. False if a coordinate is not finite.
    pub fn contains_way(&self, point: &Position, way: &Velocity) -> bool {
        self.contains_path(point, &[*way])
    }

    /// Whether the path from `point` straight to each of the `places` (m, from `point`) in turn
    /// stays inside, as [`Fence::contains_way`] has it.
    pub fn contains_path(&self, point: &Position, places: &[Velocity]) -> bool {
        let mut from = *point;
        self.contains(point)
            && places.iter().all(|place| {
                let at = point + place;
                // Both ends may be inside with a corner of the polygon between them.
                let stays = self.contains(&at)
                    && !self.sides().any(|(_, a, b)| sides_meet(&from, &at, &a, &b));
                from = at;
                stays
            })
    }

    fn contains(&self, point: &Position) -> bool {
        point.x.is_finite() && point.y.is_finite() && self.clearance(point) >= 0.0
    }

    /// Every side: the index of its first corner, and both corners.
    fn sides(&self) -> impl Iterator<Item = (usize, Position, Position)> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners
            .iter()
            .zip(next)
            .enumerate()
            .map(|(index, (from, to))| (index, *from, *to))
    }

    /// Whether the polygon encloses the point: a ray from it along x crosses the sides
    /// an odd number of times.
    fn encloses(&self, point: &Position) -> bool {
        self.sides().fold(false, |inside, (_, from, to)| {
            let spans = (from.y > point.y) != (to.y > point.y);
            let crosses =
                spans && point.x < from.x + (point.y - from.y) / (to.y - from.y) * (to.x - from.x);
            inside != crosses
        })
    }

    fn check_sides(&self) -> Result<(), FenceError> {
        let count = self.corners.len();
        for (first, a, b) in self.sides() {
            for (second, c, d) in self.sides().skip(first + 1) {
                let neighbours = second == first + 1 || (first == 0 && second == count - 1);
                let meet = if neighbours {
                    // They share a corner, and must not lie on each other.
                    let (shared, one, other) = if second == first + 1 {
                        (b, a, d)
                    } else {
                        (a, b, c)
                    };
                    let (u, v) = (one - shared, other - shared);
                    u.perp(&v) == 0.0 && u.dot(&v) >= 0.0
                } else {
                    sides_meet(&a, &b, &c, &d)
                };
                if meet {
                    return Err(FenceError::Crosses(first, second));
                }
            }
        }
        Ok(())
    }
}

fn squared_distance_to_side(point: &Position, from: &Position, to: &Position) -> f64 {
    let side = to - from;
    let length_squared = side.norm_squared();
    let along = if length_squared > 0.0 {
        ((point - from).dot(&side) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let off = point - (from + along * side);
    off.norm_squared()
}

/// Whether the segments from a to b and from c to d have a point in common.
fn sides_meet(a: &Position, b: &Position, c: &Position, d: &Position) -> bool {
    let turn = |p: &Position, q: &Position, r: &Position| (q - p).perp(&(r - p));
    let (abc, abd) = (turn(a, b, c), turn(a, b, d));
    let (cda, cdb) = (turn(c, d, a), turn(c, d, b));
    let proper = abc * abd < 0.0 && cda * cdb < 0.0;
    let within = |p: &Position, q: &Position, r: &Position| {
        fabs(r.x - 0.5 * (p.x + q.x)) <= 0.5 * fabs(q.x - p.x)
            && fabs(r.y - 0.5 * (p.y + q.y)) <= 0.5 * fabs(q.y - p.y)
    };
    proper
        || (abc == 0.0 && within(a, b, c))
        || (abd == 0.0 && within(a, b, d))
        || (cda == 0.0 && within(c, d, a))
        || (cdb == 0.0 && within(c, d, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 2 m about the origin.
    fn square(margin: f64) -> Result<Fence, FenceError> {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        Fence::new(&corners.map(|(x, y)| Position::new(x, y)), margin)
    }

    fn carpet() -> Fence {
        square(0.0).unwrap()
    }

    /// An L: the square from (0, 0) to (2, 2) without the part beyond (1, 1).
    fn l_shape() -> Fence {
        let corners = [
            (0.0, 0.0),
            (2.0, 0.0),
            (2.0, 1.0),
            (1.0, 1.0),
            (1.0, 2.0),
            (0.0, 2.0),
        ];
        Fence::new(&corners.map(|(x, y)| Position::new(x, y)), 0.0).unwrap()
    }

    #[test]
    fn clearance_is_the_distance_to_the_nearest_side_and_negative_outside() {
        let fence = carpet();
        for (x, y, clearance) in [
            (0.0, 0.0, 1.0),
            (0.7, -0.2, 0.3),
            (1.25, 0.0, -0.25),
            (1.3, 1.4, -0.5),
            (-0.9, 0.95, 0.05),
        ] {
            let found = fence.clearance(&Position::new(x, y));
            assert!((found - clearance).abs() < 1e-12, "({x}, {y}): {found}");
        }
        let with_margin = square(0.2).unwrap();
        assert!((with_margin.clearance(&Position::origin()) - 0.8).abs() < 1e-12);
        // From inside the margin to beyond the side, at every side.
        for distance in [0.81, 0.9, 1.0, 1.1] {
            for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
                let point = distance * Position::new(x, y);
                let found = with_margin.clearance(&point);
                assert!((found - (0.8 - distance)).abs() < 1e-12, "{point}: {found}");
                assert!(!with_margin.contains_way(&point, &Velocity::zeros()));
            }
        }
    }

    #[test]
    fn a_path_that_ends_outside_or_cuts_a_corner_is_not_inside() {
        let way = |x: f64, y: f64, dx: f64, dy: f64| {
            l_shape().contains_way(&Position::new(x, y), &Velocity::new(dx, dy))
        };
        assert!(way(0.5, 0.5, 1.0, 0.2));
        assert!(!way(0.5, 0.5, 1.6, 0.0), "beyond the side");
        assert!(
            !way(0.5, 1.5, 1.2, -0.9),
            "both ends inside, a corner between them"
        );
        assert!(!way(1.5, 1.5, 0.0, 0.0), "in the part that is cut out");
        assert!(!way(-0.1, 0.5, 0.5, 0.0), "begins outside");
        assert!(!way(f64::NAN, 0.5, 0.0, 0.0) && !way(0.5, 0.5, f64::NAN, 0.0));
    }

    #[test]
    fn corners_that_enclose_no_area_are_rejected() {
        let new = |corners: &[(f64, f64)]| {
            let corners: std::vec::Vec<_> =
                corners.iter().map(|&(x, y)| Position::new(x, y)).collect();
            Fence::new(&corners, 0.0)
        };
        assert_eq!(new(&[(0.0, 0.0), (1.0, 0.0)]), Err(FenceError::Corners(2)));
        assert_eq!(new(&[(0.0, 0.0); 17]), Err(FenceError::Corners(17)));
        let bow = [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)];
        assert_eq!(new(&bow), Err(FenceError::Crosses(0, 2)));
        for flat in [
            [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)],
            [(0.0, 0.0), (1.0, 0.0), (1.0, 0.0)],
            [(0.0, 0.0), (2.0, 0.0), (1.0, 0.0)],
        ] {
            assert!(
                matches!(new(&flat), Err(FenceError::Crosses(..))),
                "{flat:?}"
            );
        }
        assert!(matches!(
            new(&[(0.0, 0.0), (1.0, f64::NAN), (1.0, 1.0)]),
            Err(FenceError::NotFinite(1, ..))
        ));
        assert!(square(-0.1).is_err(), "negative margin");
    }
}
