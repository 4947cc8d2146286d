//! Limit cycles: the periodic motions that are born at a Hopf point, followed over dl.
//!
//! The straight motion is its own mirror image, and so are the cycles that leave it: after half
//! a period T every state has changed its sign. A cycle is therefore a solution of
//! `x(T/2) + x(0) = 0` from a section on which the last state is zero: single shooting over half
//! a period. Pseudo-arclength continuation (Keller) follows the branch around folds. Dual numbers
//! through the integrator give the derivatives, and with them the Floquet multipliers: the
//! squares of the eigenvalues of the mirrored return map of the section.
//!
//! Cycles that are not their own mirror image are not followed. They begin where a multiplier
//! passes 1 without a fold.

use core::f64::consts::{PI, TAU};

use nalgebra::{Complex, Const, DMatrix, DVector, Schur, U1};
use num_dual::DualSVec64;

use super::{
    closed_loop::{ClosedLoop, Law},
    hopf::HopfPoint,
    lyapunov::null_vector,
    motion::Motion,
    vector_field::{FrontPointField, MOST_STEPS, VectorField, VelocityPointField},
};

/// A periodic motion around the straight one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitCycle {
    /// The deviation dl of the centre of mass, in m.
    pub deviation: f64,
    /// Half the peak-to-peak steering angle, in rad.
    pub amplitude: f64,
    /// The period, in s.
    pub period: f64,
    /// The largest modulus of a Floquet multiplier, besides that of the shift along the cycle,
    /// which is 1.
    pub multiplier: f64,
}

impl LimitCycle {
    /// Whether small disturbances of the cycle decay.
    pub fn is_stable(&self) -> bool {
        self.multiplier < 1.0
    }
}

/// The limit cycles that are born at a Hopf point.
#[derive(Clone, Debug, PartialEq)]
pub struct CycleBranch {
    /// Those at the deviations that were asked for, in the order of the branch.
    pub cycles: Vec<LimitCycle>,
    /// Where the branch turns back in dl.
    pub folds: Vec<LimitCycle>,
    /// The last cycle that was computed; none if not even the first one was.
    pub last: Option<LimitCycle>,
    /// Whether the branch was left for being out of the deviations. Else no further cycle can be
    /// computed: the law or the car becomes singular, the wheels turn right round, or
    /// disturbances grow beyond the precision of shooting.
    pub is_out_of_range: bool,
}

/// The length of the first step along the branch, in its scaled coordinates, and the bounds of
/// the others.
const FIRST_STEP: f64 = 0.01;
const LARGEST_STEP: f64 = 0.1;
const CORNER_STEP: f64 = 0.02;
const SMALLEST_STEP: f64 = 1e-5;
/// Steps along a branch, far more than one has.
const MOST_POINTS: u32 = 2_000;
/// Newton's method: its steps, the size of the last one, and the largest one that may be due to
/// roundings.
const MOST_CORRECTIONS: u32 = 10;
const CONVERGED: f64 = 1e-10;
const ROUNDING: f64 = 1e-7;
/// Tangents that are less steep than this are those of a fold, or of a branch that ends at one dl.
const FOLD: f64 = 1e-8;
const MOST_BISECTIONS: u32 = 40;
/// Largest multiplier: errors of the integrator grow as much.
const LARGEST_MULTIPLIER: f64 = 1e9;

/// A number with its derivatives by up to three states, the period and dl.
type Jet = DualSVec64<5>;

impl ClosedLoop {
    /// The limit cycles of the branch from a Hopf point of this loop, at those of `deviations`
    /// (dl in m, ascending) that it reaches, as often as it does.
    ///
    /// The branch is followed as far as a wheelbase beyond the deviations and the Hopf point.
    pub fn limit_cycles(&self, hopf: &HopfPoint, deviations: &[f64]) -> CycleBranch {
        match self.law {
            Law::FrontPoint => follow(&FrontPointField(self), hopf, deviations),
            Law::VelocityPoint => follow(&VelocityPointField(self), hopf, deviations),
        }
    }
}

/// A cycle as a point of its branch.
#[derive(Clone)]
struct Point {
    /// The unknowns, each over its scale: the states on the section but for the last, which is
    /// zero, the period and dl.
    scaled: DVector<f64>,
    /// The direction of the branch.
    tangent: DVector<f64>,
    cycle: LimitCycle,
}

/// The equations of the cycles of N states, which have N + 1 unknowns.
struct Equations<'a, F, const N: usize> {
    field: &'a F,
    scale: DVector<f64>,
}

fn follow<F: VectorField<N>, const N: usize>(
    field: &F,
    hopf: &HopfPoint,
    deviations: &[f64],
) -> CycleBranch {
    let mut branch = CycleBranch {
        cycles: Vec::new(),
        folds: Vec::new(),
        last: None,
        is_out_of_range: false,
    };
    let equations = Equations::<F, N>::new(field, hopf);
    let Some(mut point) = equations.first(hopf) else {
        return branch;
    };
    let margin = field.closed_loop().vehicle.wheelbase_m();
    let lowest = deviations.iter().copied().fold(hopf.deviation, f64::min) - margin;
    let highest = deviations.iter().copied().fold(hopf.deviation, f64::max) + margin;
    let mut length = FIRST_STEP;
    for _ in 0..MOST_POINTS {
        branch.last = Some(point.cycle);
        branch.is_out_of_range = !(lowest..=highest).contains(&point.cycle.deviation);
        if branch.is_out_of_range {
            break;
        }
        let (next, fold) = if length > SMALLEST_STEP {
            let Some(next) = equations.next(&point, length) else {
                length *= 0.5;
                continue;
            };
            let fold = equations.fold(&point, &next, length);
            (next, fold)
        } else {
            let Some(next) = equations.around_corner(&point) else {
                break;
            };
            length = FIRST_STEP;
            let turns = point.tangent[N] * next.tangent[N] < 0.0;
            (next, turns.then(|| point.clone()))
        };
        branch.folds.extend(fold.iter().map(|fold| fold.cycle));
        let ends = [Some(point), fold, Some(next.clone())];
        let ends: Vec<Point> = ends.into_iter().flatten().collect();
        for pair in ends.windows(2) {
            let [from, to] = pair else { continue };
            branch
                .cycles
                .extend(equations.between(from, to, deviations));
        }
        point = next;
        length = (1.5 * length).min(LARGEST_STEP);
    }
    branch
}

impl<'a, F: VectorField<N>, const N: usize> Equations<'a, F, N> {
    fn new(field: &'a F, hopf: &HopfPoint) -> Self {
        let mut scale = DVector::from_element(N + 1, 1.0);
        scale[1] = hopf.angular_frequency;
        scale[N - 1] = TAU / hopf.angular_frequency;
        scale[N] = field.closed_loop().vehicle.wheelbase_m();
        Self { field, scale }
    }

    /// The first cycle, off the Hopf point along its eigenvector.
    fn first(&self, hopf: &HopfPoint) -> Option<Point> {
        let at_hopf = self.field.closed_loop().with_deviation(hopf.deviation);
        let jacobian = at_hopf.ok()?.jacobian();
        let i_omega = Complex::new(0.0, hopf.angular_frequency);
        let shifted =
            jacobian.map(|entry| Complex::new(entry, 0.0)) - DMatrix::identity(N, N) * i_omega;
        let q = null_vector(shifted)?;
        // In the phase in which the last state passes through zero.
        let phase = Complex::new(0.0, 1.0) * q[N - 1].conj();
        let mut tangent = DVector::zeros(N + 1);
        for state in 0..N - 1 {
            tangent[state] = (q[state] * phase).re / self.scale[state];
        }
        tangent.normalize_mut();
        let mut scaled = DVector::zeros(N + 1);
        scaled[N - 1] = 1.0;
        scaled[N] = hopf.deviation / self.scale[N];
        self.corrected(&scaled + &tangent * FIRST_STEP, &tangent, &tangent)
    }

    /// The cycle a step farther along the branch.
    fn next(&self, point: &Point, length: f64) -> Option<Point> {
        let guess = &point.scaled + &point.tangent * length;
        let next = self.corrected(guess, &point.tangent, &point.tangent)?;
        // Not on another branch, such as the straight motion, which has any period; and not
        // beyond a corner, where the motion first touches a stop, before the step is short.
        let is_near = next.scaled.metric_distance(&point.scaled) < 1.1 * length;
        let is_smooth = next.tangent.dot(&point.tangent) > 0.5 || length < CORNER_STEP;
        (is_near && is_smooth).then_some(next)
    }

    /// The cycle beyond a corner, where the motion first touches a steering stop: the branch may
    /// turn back there more sharply than a step along its tangent can follow. The period goes on.
    fn around_corner(&self, point: &Point) -> Option<Point> {
        let mut axis = DVector::zeros(N + 1);
        axis[N - 1] = point.tangent[N - 1].signum();
        let guess = &point.scaled + &axis * FIRST_STEP;
        let next = self.corrected(guess, &axis, &axis)?;
        let stop = self.field.closed_loop().saturation.max_steering;
        let is_near = next.scaled.metric_distance(&point.scaled) < LARGEST_STEP;
        (is_near && point.cycle.amplitude < stop && next.cycle.amplitude >= stop).then_some(next)
    }

    /// The fold within a step, if the branch turns back.
    fn fold(&self, point: &Point, next: &Point, length: f64) -> Option<Point> {
        let (mut low, mut high) = ([0.0, point.tangent[N]], [length, next.tangent[N]]);
        let turns = low[1] * high[1] < 0.0 && low[1].abs().min(high[1].abs()) > FOLD;
        let mut fold = turns.then(|| next.clone())?;
        for bisection in 0..MOST_BISECTIONS {
            // The secant is fast; at a corner the middle is safe.
            let part = if bisection % 2 == 0 {
                low[1] / (low[1] - high[1])
            } else {
                0.5
            };
            let at = low[0] + part * (high[0] - low[0]);
            let Some(nearer) = self.next(point, at) else {
                break;
            };
            fold = nearer;
            let end = [at, fold.tangent[N]];
            if end[1].abs() < FOLD {
                break;
            }
            if end[1] * low[1] > 0.0 {
                low = end;
            } else {
                high = end;
            }
        }
        Some(fold)
    }

    /// The cycles at those of `deviations` that lie between two neighbouring points.
    fn between(&self, from: &Point, to: &Point, deviations: &[f64]) -> Vec<LimitCycle> {
        let [begin, end] = [from, to].map(|point| point.cycle.deviation);
        let mut axis = DVector::zeros(N + 1);
        axis[N] = 1.0;
        let at = |deviation: f64| {
            let part = (deviation - begin) / (end - begin);
            let mut guess = from.scaled.lerp(&to.scaled, part);
            guess[N] = deviation / self.scale[N];
            let found = self.corrected(guess, &axis, &from.tangent)?;
            Some(LimitCycle {
                deviation,
                ..found.cycle
            })
        };
        let mut passed = deviations.to_vec();
        passed.retain(|dl| (begin < *dl && *dl <= end) || (end <= *dl && *dl < begin));
        if begin > end {
            passed.reverse();
        }
        passed.into_iter().filter_map(at).collect()
    }

    /// The cycle in the plane through a guess across `normal`, by Newton's method. Its tangent
    /// is on the side of `forward`.
    fn corrected(
        &self,
        guess: DVector<f64>,
        normal: &DVector<f64>,
        forward: &DVector<f64>,
    ) -> Option<Point> {
        let mut scaled = guess;
        let mut last = f64::INFINITY;
        for _ in 0..MOST_CORRECTIONS {
            let (residual, jacobian, amplitude) = self.half_turn(&scaled)?;
            let with_row = |row: &DVector<f64>| {
                let mut matrix = jacobian.clone().insert_row(N, 0.0);
                matrix.set_row(N, &row.transpose());
                matrix.lu()
            };
            let correction = with_row(normal).solve(&residual.insert_row(N, 0.0))?;
            scaled -= &correction;
            let size = correction.norm();
            if size < CONVERGED || (size < ROUNDING && size > 0.5 * last) {
                let mut ahead = DVector::zeros(N + 1);
                ahead[N] = 1.0;
                return Some(Point {
                    tangent: with_row(forward).solve(&ahead)?.normalize(),
                    cycle: LimitCycle {
                        deviation: scaled[N] * self.scale[N],
                        amplitude,
                        period: scaled[N - 1] * self.scale[N - 1],
                        multiplier: self.multiplier(&jacobian)?,
                    },
                    scaled,
                });
            }
            last = size;
        }
        None
    }

    /// x(T/2) + x(0), its derivatives by the scaled unknowns, and the amplitude. None if the
    /// motion becomes singular or turns the wheels right round.
    fn half_turn(&self, scaled: &DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>, f64)> {
        let unknown = |index: usize| Jet::from(scaled[index] * self.scale[index]).derivative(index);
        let mut start = [Jet::from(0.0); N];
        for (index, state) in start.iter_mut().take(N - 1).enumerate() {
            *state = unknown(index);
        }
        let end = unknown(N - 1) * 0.5;
        let mut motion = Motion::new(self.field, start, unknown(N));
        while motion.time.re < end.re {
            motion.step(end).ok()?;
        }
        let residual: Vec<Jet> = start.iter().zip(motion.state).map(|(x, y)| y + x).collect();
        let jacobian = DMatrix::from_fn(N, N + 1, |row, column| {
            let derivatives = residual[row].eps.unwrap_generic(Const::<5>, U1);
            derivatives[column] * self.scale[column]
        });
        let residual = DVector::from_iterator(N, residual.iter().map(|value| value.re));
        (motion.amplitude < PI).then_some((residual, jacobian, motion.amplitude))
    }

    /// The multiplier of a cycle from the derivatives of x(T/2) + x(0).
    fn multiplier(&self, jacobian: &DMatrix<f64>) -> Option<f64> {
        // A disturbed motion reaches the section earlier or later, as the last row says.
        let last = jacobian.row(N - 1);
        let mirrored = DMatrix::from_fn(N - 1, N - 1, |row, column| {
            let later = jacobian[(row, N - 1)] * last[column] / last[N - 1];
            let sum = (jacobian[(row, column)] - later) / self.scale[column];
            if row == column { 1.0 - sum } else { -sum }
        });
        let schur = Schur::try_new(mirrored, f64::EPSILON, MOST_STEPS)?;
        let eigenvalues = schur.complex_eigenvalues();
        let moduli = eigenvalues.iter().map(Complex::norm_sqr);
        let largest = moduli.fold(0.0, f64::max);
        (largest < LARGEST_MULTIPLIER).then_some(largest)
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Tyres, VehicleParameters};

    use super::*;
    use crate::stability::{Belief, Saturation, hopf_points};

    /// With saturating tyres, a limited steering rate and contacts with the stops.
    #[test]
    fn derivatives_through_a_steering_stop_equal_difference_quotients() {
        let vehicle = VehicleParameters::paper();
        let saturation = Saturation {
            tyres: Tyres::Saturating,
            max_steering: 0.45,
            max_steering_rate: 2.0,
            ..Saturation::NONE
        };
        let at = ClosedLoop::new(vehicle, Law::FrontPoint, 0.35, 2.5, -0.1).unwrap();
        let at = at.saturating(saturation).unwrap();
        let hopf = hopf_points(vehicle, at.law, Belief::CentreOfMass, 0.35, 2.5).unwrap();
        let field = FrontPointField(&at);
        let equations = Equations::<_, 4>::new(&field, &hopf[0]);
        let scaled = DVector::from_vec(vec![-0.7, 0.3, 0.1, 1.6, -0.4]);
        let (_, jacobian, amplitude) = equations.half_turn(&scaled).unwrap();
        assert_eq!(amplitude, 0.45);
        for column in 0..5 {
            let moved = |by: f64| {
                let mut moved = scaled.clone();
                moved[column] += by;
                equations.half_turn(&moved).unwrap().0
            };
            let quotient = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let error = (&quotient - jacobian.column(column)).norm();
            assert!(
                error < 1e-6 * (1.0 + quotient.norm()),
                "{column}: {quotient} {jacobian}"
            );
        }
    }
}
