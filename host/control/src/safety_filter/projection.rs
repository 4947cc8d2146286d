//! The nearest velocity within half-planes and a disc: a quadratic program of two unknowns.

use heapless::Vec;
use libm::sqrt;

use crate::{MAX_AREA_CORNERS, MAX_NEIGHBOURS, Velocity};

/// One for each side of the area, two for each other body, one for the speed in the bend, and two
/// for its steering.
pub(super) const MOST: usize = MAX_AREA_CORNERS + 2 * MAX_NEIGHBOURS + 3;

/// What a bound may be exceeded by through rounding, m/s.
const ROUNDING: f64 = 1e-12;

/// The velocities v with `along`·v <= `most`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HalfPlane {
    /// A unit vector.
    pub(super) along: Velocity,
    /// Not negative, so that standing is always allowed.
    pub(super) most: f64,
}

impl HalfPlane {
    fn excess(&self, velocity: &Velocity) -> f64 {
        self.along.dot(velocity) - self.most
    }
}

/// The velocity nearest to `wanted` within all `planes` and no faster than `speed`.
///
/// At the optimum at most two bounds are reached. There are so few that all places where that
/// can be are tried, which is exact and always takes the same time. `wanted` must be finite.
pub(super) fn nearest(wanted: &Velocity, planes: &Vec<HalfPlane, MOST>, speed: f64) -> Velocity {
    // Standing is the last resort, which every bound allows.
    let mut best = (wanted.norm_squared(), Velocity::zeros());
    let mut consider = |candidate: Velocity| {
        let distance = (candidate - wanted).norm_squared();
        let allowed = candidate.norm_squared() <= speed * speed + ROUNDING
            && planes
                .iter()
                .all(|plane| plane.excess(&candidate) <= ROUNDING);
        if distance < best.0 && allowed {
            best = (distance, candidate);
        }
    };
    consider(*wanted);
    let wanted_speed = sqrt(wanted.norm_squared());
    if wanted_speed > speed {
        consider(wanted * (speed / wanted_speed));
    }
    for (index, plane) in planes.iter().enumerate() {
        // Near the line, at its crossing with the circle, and with the other lines.
        consider(wanted - plane.along * plane.excess(wanted));
        let across = Velocity::new(-plane.along.y, plane.along.x);
        let half_chord = speed * speed - plane.most * plane.most;
        if half_chord >= 0.0 {
            let half_chord = sqrt(half_chord);
            consider(plane.along * plane.most + across * half_chord);
            consider(plane.along * plane.most - across * half_chord);
        }
        for other in planes.iter().skip(index + 1) {
            let slope = other.along.dot(&across);
            let along_line = (other.most - plane.most * other.along.dot(&plane.along)) / slope;
            // Parallel lines cross nowhere: no such candidate is allowed.
            consider(plane.along * plane.most + across * along_line);
        }
    }
    best.1
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use clarabel::{
        algebra::CscMatrix,
        solver::{
            DefaultSettingsBuilder, DefaultSolver, IPSolver as _, NonnegativeConeT,
            SecondOrderConeT,
        },
    };
    use proptest::prelude::*;

    use super::*;

    fn by_clarabel(wanted: &Velocity, planes: &Vec<HalfPlane, MOST>, speed: f64) -> Velocity {
        let count = planes.len();
        let mut rows: std::vec::Vec<[f64; 2]> =
            planes.iter().map(|plane| plane.along.into()).collect();
        rows.extend([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]);
        let mut right: std::vec::Vec<f64> = planes.iter().map(|plane| plane.most).collect();
        right.extend([speed, 0.0, 0.0]);
        let settings = DefaultSettingsBuilder::default()
            .verbose(false)
            .tol_gap_abs(1e-12)
            .tol_gap_rel(1e-12)
            .tol_feas(1e-12)
            .build()
            .unwrap();
        let mut solver = DefaultSolver::new(
            &CscMatrix::identity(2),
            &[-wanted.x, -wanted.y],
            &CscMatrix::from(&rows),
            &right,
            &[NonnegativeConeT(count), SecondOrderConeT(3)],
            settings,
        )
        .unwrap();
        solver.solve();
        Velocity::new(solver.solution.x[0], solver.solution.x[1])
    }

    proptest! {
        #[test]
        fn the_nearest_velocity_is_that_of_an_interior_point_solver(
            x in -3.0..3.0,
            y in -3.0..3.0,
            bounds in proptest::collection::vec((-4.0..4.0_f64, 0.0..2.0), 1..8),
            speed in 0.2..2.0,
        ) {
            let wanted = Velocity::new(x, y);
            let planes = bounds
                .iter()
                .map(|(angle, most)| HalfPlane { along: crate::direction(*angle), most: *most })
                .collect();
            let ours = nearest(&wanted, &planes, speed);
            let theirs = by_clarabel(&wanted, &planes, speed);
            // Near the optimum the distance hardly changes, so that an interior-point solver
            // ends some 1e-5 m/s from it.
            prop_assert!((ours - theirs).norm() < 1e-3, "{ours} against {theirs}");
            let (of_ours, of_theirs) = ((ours - wanted).norm(), (theirs - wanted).norm());
            // It ends inside of the bounds, up to 1e-5 m/s from where the optimum touches them.
            prop_assert!(of_ours <= of_theirs + 1e-9, "{of_ours} against {of_theirs}");
            prop_assert!(planes.iter().all(|plane| plane.excess(&ours) <= 1e-9));
            prop_assert!(ours.norm() <= speed + 1e-9);
        }

        #[test]
        fn what_every_bound_allows_is_not_changed(
            x in -1.0..1.0,
            y in -1.0..1.0,
            angles in proptest::collection::vec(-4.0..4.0_f64, 1..17),
        ) {
            let wanted = Velocity::new(x, y);
            let planes = angles
                .iter()
                .map(|angle| HalfPlane { along: crate::direction(*angle), most: 1.5 })
                .collect();
            prop_assert_eq!(nearest(&wanted, &planes, 1.5), wanted);
        }
    }
}
