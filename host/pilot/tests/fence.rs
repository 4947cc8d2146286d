//! The geometry of the geofence, with arbitrary corners.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_control::{Position, Velocity, angle_between};
use singletrack_pilot::{Fence, FenceError};

fn positions(corners: &[(f64, f64)]) -> Vec<Position> {
    corners.iter().map(|&(x, y)| Position::new(x, y)).collect()
}

/// Whether the polygon encloses the point, by the sum of the angles of its sides as seen
/// from the point: slow, and independent of the geofence's own method.
fn winds_around(corners: &[Position], point: &Position) -> bool {
    let next = corners.iter().cycle().skip(1);
    let turned: f64 = corners
        .iter()
        .zip(next)
        .map(|(from, to)| angle_between(&(from - point), &(to - point)))
        .sum();
    turned.abs() > std::f64::consts::PI
}

type Corner = (i32, i32);

/// Whether two sides have a point in common, exactly. Two segments are separate if and
/// only if their projections along or across one of them are.
fn meet(one: [Corner; 2], other: [Corner; 2]) -> bool {
    let along = |[from, to]: [Corner; 2]| (to.0 - from.0, to.1 - from.1);
    let axes = [along(one), along(other)].map(|(x, y)| [(x, y), (-y, x)]);
    let shadow = |side: [Corner; 2], (x, y): (i32, i32)| {
        let ends = side.map(|corner| corner.0 * x + corner.1 * y);
        ends[0].min(ends[1])..=ends[0].max(ends[1])
    };
    axes.as_flattened().iter().all(|&axis| {
        let (one, other) = (shadow(one, axis), shadow(other, axis));
        one.start() <= other.end() && other.start() <= one.end()
    })
}

/// Whether two sides meet, apart from the corner that neighbours share.
fn sides_meet(corners: &[Corner], first: usize, second: usize) -> bool {
    let count = corners.len();
    let side = |index: usize| [corners[index], corners[(index + 1) % count]];
    let folds =
        |one: [Corner; 2], next: [Corner; 2]| meet([one[0]; 2], next) || meet(one, [next[1]; 2]);
    if second == first + 1 {
        folds(side(first), side(second))
    } else if (first, second) == (0, count - 1) {
        folds(side(second), side(first))
    } else {
        meet(side(first), side(second))
    }
}

/// Corners in order around the origin, at random distances.
fn star() -> impl Strategy<Value = Vec<Position>> {
    (
        proptest::collection::vec(1..=8_u8, 3..=16),
        0.0..std::f64::consts::TAU,
        any::<bool>(),
    )
        .prop_map(|(radii, first, clockwise)| {
            let step = std::f64::consts::TAU / radii.len() as f64;
            let mut corners: Vec<_> = radii
                .iter()
                .enumerate()
                .map(|(index, &radius)| {
                    let angle = first + step * index as f64;
                    f64::from(radius) * Position::new(angle.cos(), angle.sin())
                })
                .collect();
            if clockwise {
                corners.reverse();
            }
            corners
        })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 500,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn a_point_is_inside_if_and_only_if_the_polygon_winds_around_it(
        corners in star(),
        (x, y) in (-9.0..9.0, -9.0..9.0),
        level_with in any::<prop::sample::Index>(),
    ) {
        let fence = Fence::new(&corners, 0.0).unwrap();
        // Also a point level with a corner: a ray from it meets two sides at once.
        let level = corners[level_with.index(corners.len())].y;
        for point in [Position::new(x, y), Position::new(x, level)] {
            let clearance = fence.clearance(&point);
            if clearance.abs() > 1e-9 {
                prop_assert_eq!(clearance > 0.0, winds_around(&corners, &point), "{}", point);
                let stays = fence.contains_way(&point, &Velocity::zeros());
                prop_assert_eq!(stays, clearance > 0.0);
            }
        }
    }

    /// On a small grid, sides often touch and overlap.
    #[test]
    fn corners_are_rejected_if_and_only_if_two_sides_meet_and_the_error_names_them(
        corners in proptest::collection::vec((0..5_i32, 0..5_i32), 3..7),
    ) {
        let metres: Vec<_> = corners
            .iter()
            .map(|&(x, y)| (0.25 * f64::from(x), 0.25 * f64::from(y)))
            .collect();
        let pairs = (0..corners.len()).flat_map(|first| (0..first).map(move |second| (second, first)));
        let mut meeting = pairs.filter(|&(first, second)| sides_meet(&corners, first, second));
        match Fence::new(&positions(&metres), 0.0) {
            Ok(_) => prop_assert_eq!(meeting.next(), None),
            Err(FenceError::Crosses { first, second }) => {
                prop_assert!(meeting.any(|pair| pair == (first, second)));
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    #[test]
    fn a_path_is_inside_if_and_only_if_all_its_points_are(
        corners in star(),
        (x, y) in (-4.0..4.0, -4.0..4.0),
        (dx, dy) in (-4.0..4.0, -4.0..4.0),
    ) {
        let fence = Fence::new(&corners, 0.0).unwrap();
        let (point, way) = (Position::new(x, y), Velocity::new(dx, dy));
        let least = (0..=60)
            .map(|step| fence.clearance(&(point + f64::from(step) / 60.0 * way)))
            .fold(f64::INFINITY, f64::min);
        // The samples are up to a tenth of a metre apart: closer cases are not decided.
        if least.abs() > 0.05 {
            prop_assert_eq!(fence.contains_way(&point, &way), least > 0.0);
        }
    }
}

#[test]
fn the_clearance_of_a_triangle_is_known() {
    let fence = Fence::new(&positions(&[(0.0, 0.0), (4.0, 0.0), (0.0, 3.0)]), 0.0).unwrap();
    for (x, y, clearance) in [
        // The centre of the inscribed circle.
        (1.0, 1.0, 1.0),
        (2.0, 0.5, 0.5),
        (4.0, 3.0, -2.4),
        (-1.0, 0.0, -1.0),
        (-3.0, 7.0, -5.0),
        (5.0, 0.0, -1.0),
    ] {
        let found = fence.clearance(&Position::new(x, y));
        assert!((found - clearance).abs() < 1e-12, "({x}, {y}): {found}");
    }
}

#[test]
fn collinear_sides_meet_only_if_they_overlap() {
    // A U, upright and on its side: its arms end on the same line.
    let arms = [
        (0.0, 0.0),
        (3.0, 0.0),
        (3.0, 2.0),
        (2.0, 2.0),
        (2.0, 1.0),
        (1.0, 1.0),
        (1.0, 2.0),
        (0.0, 2.0),
    ];
    for corners in [arms, arms.map(|(x, y)| (y, x))] {
        let fence = Fence::new(&positions(&corners), 0.0);
        assert!(fence.is_ok(), "{fence:?}");
    }
    // The second arm bent onto the end of the first.
    let bent = arms.map(|corner| {
        if corner == (2.0, 2.0) {
            (0.5, 2.0)
        } else {
            corner
        }
    });
    assert!(matches!(
        Fence::new(&positions(&bent), 0.0),
        Err(FenceError::Crosses { .. })
    ));
}
