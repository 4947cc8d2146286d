//! Quadratic programs, solved by the interior-point solver Clarabel. They stand here and not where they
//! are used: this crate is optimised in tests, and the solver is compiled with its caller.

pub use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver as _, NonnegativeConeT, SolverStatus,
};

/// The z with the least zᵀHz/2 + gᵀz of those with `rows`·z ≤ `bounds`: H is `cost`, of which only the
/// upper triangle counts, and g is `gradient`. Gaps and infeasibility are below 1e-6 of the scale of the
/// cost. None if the solver finds none, or where a number is not finite.
pub fn minimum(
    cost: &CscMatrix,
    gradient: &[f64],
    rows: &CscMatrix,
    bounds: &[f64],
) -> Option<Vec<f64>> {
    if !gradient.iter().all(|slope| slope.is_finite()) {
        return None;
    }
    let settings = DefaultSettings {
        verbose: false,
        equilibrate_enable: false,
        tol_gap_abs: 1e-6,
        tol_gap_rel: 1e-6,
        tol_feas: 1e-6,
        ..DefaultSettings::default()
    };
    let cones = [NonnegativeConeT(bounds.len())];
    let mut solver = DefaultSolver::new(cost, gradient, rows, bounds, &cones, settings).ok()?;
    solver.solve();
    let solution = &solver.solution;
    let solved = matches!(
        solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved
    );
    (solved && solution.x.iter().all(|x| x.is_finite())).then(|| solution.x.clone())
}
