//! The plan at convergence against an interior-point solver's, on the same problem.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::vec::Vec;

use clarabel::{
    algebra::CscMatrix,
    solver::{
        DefaultSettingsBuilder, DefaultSolver, IPSolver as _, NonnegativeConeT, SecondOrderConeT,
        SolverStatus, ZeroConeT,
    },
};

use super::solver::{Axis, Bounded, Bounds, COMMAND, POSITION, Solver, VELOCITY, Weights};
use crate::{ConvexArea, Position, Velocity};

const N: usize = 4;
const H: usize = 20;
const STAGE: f64 = 0.03;
const LAG: f64 = 0.08;
/// Acceleration and state of a stage, on both axes.
const WIDTH: usize = 2 * (N + 1);

struct Case {
    name: &'static str,
    start: [Velocity; N],
    nominal: [Bounded; H],
    bounds: Bounds,
    weights: Weights,
}

fn area() -> ConvexArea {
    let corners = [
        (-1.0, -1.0),
        (1.2, -0.9),
        (1.0, 1.0),
        (-0.6, 1.3),
        (-1.3, 0.2),
    ];
    ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap()
}

/// Along a straight line from `from` with `velocity`.
fn line(
    name: &'static str,
    from: Velocity,
    velocity: Velocity,
    here: Velocity,
    now: Velocity,
) -> Case {
    Case {
        name,
        start: [
            here - from,
            0.8 * now - velocity,
            now - velocity,
            now - velocity,
        ],
        nominal: core::array::from_fn(|index| Bounded {
            acceleration: Velocity::new(0.2, -0.1),
            command: velocity,
            position: from + velocity * ((index + 1) as f64 * STAGE),
        }),
        bounds: Bounds {
            acceleration: 2.0,
            speed: 1.2,
            area: Some(area()),
        },
        weights: Weights {
            position: 1.0,
            velocity: 0.02,
            acceleration: 0.004,
        },
    }
}

fn cases() -> Vec<Case> {
    let v = Velocity::new;
    let mut unbounded = line(
        "no bound reached",
        v(-0.5, 0.0),
        v(0.5, 0.1),
        v(-0.5, 0.02),
        v(0.5, 0.0),
    );
    unbounded.bounds.area = None;
    let mut weak = line(
        "other weights",
        v(0.0, 0.0),
        v(0.6, 0.6),
        v(-0.3, 0.4),
        v(0.0, -0.5),
    );
    weak.weights = Weights {
        position: 4.0,
        velocity: 0.5,
        acceleration: 0.05,
    };
    std::vec![
        unbounded,
        line(
            "far behind",
            v(-0.3, 0.5),
            v(0.5, 0.0),
            v(-0.9, -0.8),
            v(0.0, 0.0)
        ),
        line(
            "too fast",
            v(-0.9, 0.0),
            v(1.8, 0.3),
            v(-0.9, 0.1),
            v(1.0, 0.0)
        ),
        line(
            "out of the area",
            v(0.6, 0.2),
            v(0.9, 0.3),
            v(0.6, 0.2),
            v(0.9, 0.3)
        ),
        line(
            "into a corner",
            v(0.5, -0.3),
            v(0.7, -0.9),
            v(0.5, -0.3),
            v(0.4, -0.6)
        ),
        line(
            "turned round",
            v(0.0, 0.3),
            v(-1.0, 0.0),
            v(0.0, 0.3),
            v(1.0, 0.2)
        ),
        weak,
    ]
}

/// Sparse rows, which clarabel wants by columns.
#[derive(Default)]
struct Rows {
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    right: Vec<f64>,
}

impl Rows {
    fn push(&mut self, entries: &[(usize, f64)], right: f64) {
        for (column, value) in entries {
            self.rows.push(self.right.len());
            self.columns.push(*column);
            self.values.push(*value);
        }
        self.right.push(right);
    }
}

/// The accelerations and the commands that clarabel plans.
fn by_clarabel(
    case: &Case,
    axis: &Axis<N>,
    terminal: &nalgebra::SMatrix<f64, N, N>,
) -> Vec<Velocity> {
    let of_input = |stage: usize, side: usize| stage * WIDTH + side;
    let of_state = |stage: usize, row: usize, side: usize| stage * WIDTH + 2 + 2 * row + side;

    let mut cost = Rows::default();
    let linear = std::vec![0.0; H * WIDTH];
    cost.right.resize(H * WIDTH, 0.0);
    let mut quadratic = |one: usize, other: usize, value: f64| {
        cost.rows.push(one.min(other));
        cost.columns.push(one.max(other));
        cost.values.push(value);
    };
    for side in 0..2 {
        for stage in 0..H {
            let input = of_input(stage, side);
            quadratic(input, input, case.weights.acceleration);
            if stage + 1 == H {
                continue;
            }
            for (row, weight) in [
                (POSITION, case.weights.position),
                (VELOCITY, case.weights.velocity),
            ] {
                let state = of_state(stage, row, side);
                quadratic(state, state, weight);
            }
        }
        for row in 0..N {
            for column in row..N {
                let (one, other) = (of_state(H - 1, row, side), of_state(H - 1, column, side));
                quadratic(one, other, terminal[(row, column)]);
            }
        }
    }

    let mut bounds = Rows::default();
    let mut cones = Vec::new();
    for stage in 0..H {
        for side in 0..2 {
            for row in 0..N {
                let mut entries = std::vec![
                    (of_state(stage, row, side), 1.0),
                    (of_input(stage, side), -axis.input[row]),
                ];
                let mut known = 0.0;
                for column in 0..N {
                    let factor = axis.transition[(row, column)];
                    if stage == 0 {
                        known += factor * case.start[column][side];
                    } else if factor != 0.0 {
                        entries.push((of_state(stage - 1, column, side), -factor));
                    }
                }
                bounds.push(&entries, known);
            }
        }
    }
    cones.push(ZeroConeT(bounds.right.len()));
    for stage in 0..H {
        let nominal = &case.nominal[stage];
        for (most, nominal, x, y) in [
            (
                case.bounds.acceleration,
                nominal.acceleration,
                of_input(stage, 0),
                of_input(stage, 1),
            ),
            (
                case.bounds.speed,
                nominal.command,
                of_state(stage, COMMAND, 0),
                of_state(stage, COMMAND, 1),
            ),
        ] {
            bounds.push(&[], most);
            bounds.push(&[(x, -1.0)], nominal.x);
            bounds.push(&[(y, -1.0)], nominal.y);
            cones.push(SecondOrderConeT(3));
        }
        if let Some(area) = &case.bounds.area {
            for side in area.sides() {
                let at = |axis| of_state(stage, POSITION, axis);
                bounds.push(
                    &[(at(0), side.outward.x), (at(1), side.outward.y)],
                    side.offset - side.outward.dot(&nominal.position),
                );
            }
            cones.push(NonnegativeConeT(area.sides().len()));
        }
    }
    let matrix = |rows: Rows| {
        let height = rows.right.len();
        let matrix =
            CscMatrix::new_from_triplets(height, H * WIDTH, rows.rows, rows.columns, rows.values);
        (matrix, rows.right)
    };
    let (cost, _) = matrix(cost);
    let (bounds, right) = matrix(bounds);
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-13)
        .tol_gap_rel(1e-13)
        .tol_feas(1e-13)
        .iterative_refinement_reltol(1e-15)
        .iterative_refinement_abstol(1e-15)
        .static_regularization_constant(1e-11)
        .iterative_refinement_max_iter(50)
        .build()
        .unwrap();
    let mut solver = DefaultSolver::new(&cost, &linear, &bounds, &right, &cones, settings).unwrap();
    solver.solve();
    assert!(
        matches!(
            solver.solution.status,
            SolverStatus::Solved | SolverStatus::AlmostSolved | SolverStatus::InsufficientProgress
        ),
        "{:?}",
        solver.solution.status
    );
    let x = &solver.solution.x;
    (0..H)
        .flat_map(|stage| {
            [
                Velocity::new(x[of_input(stage, 0)], x[of_input(stage, 1)]),
                Velocity::new(
                    x[of_state(stage, COMMAND, 0)],
                    x[of_state(stage, COMMAND, 1)],
                ),
                Velocity::new(
                    x[of_state(stage, POSITION, 0)],
                    x[of_state(stage, POSITION, 1)],
                ),
            ]
        })
        .collect()
}

/// The largest difference to clarabel's plan after these iterations, relative to the plan's
/// largest entry, and our residual.
fn difference(case: &Case, iterations: usize) -> (f64, f64) {
    let axis = Axis::new(LAG, STAGE);
    let mut solver = Solver::<N, H>::new(axis, case.weights, case.bounds.clone()).unwrap();
    let expected = by_clarabel(case, &axis, &solver.terminal);
    let residual = solver.solve(&case.start, &case.nominal, iterations);
    let plan = solver.plan().iter();
    let ours = plan.flat_map(|stage| [stage.acceleration, stage.command, stage.position]);
    let largest = ours
        .zip(&expected)
        .map(|(one, other)| (one - other).amax())
        .fold(0.0, f64::max);
    let scale = expected.iter().map(Velocity::amax).fold(0.0, f64::max);
    (largest / scale, residual.primal.max(residual.dual))
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_converged_plan_is_that_of_an_interior_point_solver_to_1e_6() {
        for case in cases() {
            // The residual is rounding then; what is left of the difference is clarabel's tolerance.
            let (largest, left) = difference(&case, 5_000);
            assert!(left < 1e-12, "{}: {left}", case.name);
            let (after_40, residual) = difference(&case, 40);
            std::println!(
                "{}: {largest:.1e}; after 40 iterations {after_40:.1e}, residual {residual:.1e}",
                case.name
            );
            assert!(largest < 1e-6, "{}: {largest}", case.name);
        }
    }
}
