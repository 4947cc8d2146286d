//! A region of attraction of the straight motion, proved with intervals.
//!
//! In a box of states the slope of x'Px is bounded in two ways: as a form y'My in coordinates y with
//! x'Px = |y|², whose matrix has the chords of the vector field from the origin, and by its value in
//! the middle with its own chords from there. A box with neither is split.

use core::array::from_fn;

use nalgebra::{Matrix4, SMatrix, Vector4};

use super::{
    closed_loop::{ClosedLoop, Law, StabilityError},
    interval::{Chord, ChordFunctions, Interval},
    vector_field::{FrontPointField, VectorField},
};

/// The states x (yaw, yaw rate, sideslip and steering, in rad and rad/s) with x'Px up to a level
/// and the steering within its stop. On all motions from them x'Px falls: they stay, and the
/// straight motion is regained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attraction {
    /// P, positive definite.
    pub form: Matrix4<f64>,
    /// The largest x'Px.
    pub level: f64,
    /// The boxes of the proof.
    pub boxes: u32,
}

impl Attraction {
    /// The largest yaw error within, in rad, all other states being zero.
    pub fn yaw(&self) -> f64 {
        (self.level / self.form[(0, 0)]).sqrt()
    }
}

/// Boxes after which a level counts as not proved.
const MOST_BOXES: u32 = 2_500_000;
/// Directions in which a form is tried, and points of each.
const DIRECTIONS: u32 = 4_000;
const POINTS: u32 = 10;
/// Shares of the yaw error that the points allow, of which the largest that is proved is taken.
const SHARES: [f64; 7] = [0.9, 0.8, 0.7, 0.6, 0.45, 0.3, 0.15];

impl ClosedLoop {
    /// The largest region of attraction that is found and proved, with wheels that follow at once, up
    /// to a yaw error (rad); none if no level is proved.
    ///
    /// # Errors
    ///
    /// The law of the appendix.
    pub fn attraction(&self, most_yaw: f64) -> Result<Option<Attraction>, StabilityError> {
        if self.law != Law::FrontPoint {
            return Err(StabilityError::Attraction);
        }
        let best = self.best_form();
        Ok(best.and_then(|(yaw, form)| {
            SHARES.into_iter().find_map(|share| {
                let yaw = most_yaw.min(share * yaw);
                let level = form[(0, 0)] * yaw * yaw;
                let boxes = Proof::new(self, &form, level)?.boxes()?;
                Some(Attraction { form, level, boxes })
            })
        }))
    }

    /// The form that allows the largest yaw error (rad) at points, and this error.
    fn best_form(&self) -> Option<(f64, Matrix4<f64>)> {
        let mut best = None;
        // Weights of the yaw, and of yaw rate and sideslip beyond those that the steering settles to,
        // beside that of the direction of the front wheels.
        for yaw in [-1.0, 0.0, 1.0_f64] {
            for rate in [2.0, 2.5, 3.0, 3.5, 4.0_f64] {
                for sideslip in [6.0, 6.5, 7.0, 7.5, 8.0, 8.5_f64] {
                    let weights = [0.0, yaw, rate, sideslip].map(f64::exp);
                    if let Some(form) = self.form(&weights)
                        && let Some(yaw) = self.yaw_at_points(&form)
                        && best.is_none_or(|(most, _)| yaw > most)
                    {
                        best = Some((yaw, form));
                    }
                }
            }
        }
        best
    }

    /// P of Lyapunov's equation A'P + PA = -Q of the linearisation.
    fn form(&self, weights: &[f64; 4]) -> Option<Matrix4<f64>> {
        let origin = Chords::at(
            &Matrix4::identity(),
            &[Interval::ZERO; 4],
            &[Interval::ZERO; 4],
        );
        let slopes = origin.field(self).map(|row| row.slopes);
        let a = Matrix4::from_fn(|i, j| slopes[i][j].middle());
        let fast = a.fixed_view::<2, 2>(1, 1).try_inverse()?;
        let settled = -fast * a.fixed_view::<2, 1>(1, 3);
        // Each array is a column.
        let rows = Matrix4::from([
            [1.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, -settled[0], -settled[1]],
        ]);
        let q = rows.transpose() * Matrix4::from_diagonal(&Vector4::from(*weights)) * rows;
        let (one, at) = (Matrix4::<f64>::identity(), a.transpose());
        let equation: SMatrix<f64, 16, 16> = one.kronecker(&at) + at.kronecker(&one);
        let right = SMatrix::<f64, 16, 1>::from_column_slice(q.as_slice());
        let solution = equation.lu().solve(&-right)?;
        let form = Matrix4::from_column_slice(solution.as_slice());
        Some(0.5 * (form + form.transpose()))
    }

    /// Up to which yaw error (rad) x'Px falls at points.
    fn yaw_at_points(&self, form: &Matrix4<f64>) -> Option<f64> {
        let states = form.cholesky()?.l().transpose().try_inverse()?;
        let stop = self.saturation.max_steering;
        let falls = |x: Vector4<f64>| {
            let mut slope = Vector4::from(FrontPointField(self).slope(x.into()));
            let falls = (form * x).dot(&slope) < 0.0;
            if x[3].abs() >= 0.999 * stop && slope[3] * x[3] > 0.0 {
                slope[3] = 0.0;
            }
            falls && (form * x).dot(&slope) < 0.0
        };
        let mut most = 10.0_f64;
        for index in 1..=DIRECTIONS {
            // Powers of the root of x⁵ = x + 1: points that fill a cube evenly.
            let cube = from_fn(|axis| {
                let step = 0.856_674_883_854_502_9_f64.powi(axis as i32 + 1);
                2.0 * (f64::from(index) * step).fract() - 1.0
            });
            let x = states * Vector4::from(cube).normalize();
            let end = most.min(stop / x[3].abs());
            let fails = |point: &f64| !falls(x * *point);
            let mut points = (1..=POINTS).map(|k| end * f64::from(k) / f64::from(POINTS));
            most = points.find(fails).unwrap_or(most);
        }
        Some(most / form[(0, 0)].sqrt())
    }
}

type Square = [[Interval; 4]; 4];
type Region = [Interval; 4];

/// The states on a box of coordinates y, with their chords from a centre.
struct Chords([Chord<4>; 4]);

impl Chords {
    fn at(states: &Matrix4<f64>, region: &Region, centre: &Region) -> Self {
        Self(from_fn(|i| {
            let slopes: [_; 4] = from_fn(|k| Interval::exactly(states[(i, k)]));
            let at = |y: &Region| sum(|k| slopes[k] * y[k]);
            Chord {
                value: at(region),
                origin: at(centre),
                slopes,
            }
        }))
    }

    fn field(&self, closed_loop: &ClosedLoop) -> [Chord<4>; 4] {
        let deviation = Chord::from(closed_loop.deviation);
        closed_loop.front_point_slope::<ChordFunctions, _>(&self.0, deviation)
    }
}

/// A proof in coordinates y, x = Yy, in which x'Px is |y|² but for roundings.
struct Proof<'a> {
    closed_loop: &'a ClosedLoop,
    form: &'a Matrix4<f64>,
    level: f64,
    /// Y, upper triangular: the last coordinate alone is the steering.
    states: Matrix4<f64>,
    /// Y'P.
    gradient: Square,
    /// Y'PY, negative.
    outside: Square,
}

impl<'a> Proof<'a> {
    fn new(closed_loop: &'a ClosedLoop, form: &'a Matrix4<f64>, level: f64) -> Option<Self> {
        let states = form.cholesky()?.l().transpose().try_inverse()?;
        let exact = |matrix: &Matrix4<f64>| -> Square {
            from_fn(|i| from_fn(|j| Interval::exactly(matrix[(i, j)])))
        };
        let gradient = product(&exact(&states.transpose()), &exact(form));
        let outside = product(&gradient, &exact(&-states));
        // |y|² is at most a little more than x'Px, so that a box of this level has all.
        let rest = from_fn(|i| {
            from_fn(|j| outside[i][j] + Interval::exactly(if i == j { 0.999 } else { 0.0 }))
        });
        let is_wide = bound(rest, &[Interval::between(-1.0, 1.0); 4]) < 0.0;
        is_wide.then_some(Self {
            closed_loop,
            form,
            level,
            states,
            gradient,
            outside,
        })
    }

    /// How many boxes prove that x'Px falls; the field is odd, and half of the states will do.
    fn boxes(&self) -> Option<u32> {
        let most = self.level.sqrt() * 1.001;
        let stop = (self.closed_loop.saturation.max_steering / self.states[(3, 3)]).next_up();
        let mut whole = [Interval::between(-most, most); 4];
        whole[3] = Interval::between(0.0, most.min(stop));
        let mut open = vec![whole];
        for boxes in 0..MOST_BOXES {
            let Some(region) = open.pop() else {
                return Some(boxes);
            };
            if bound(self.outside, &region) < -self.level {
                continue;
            }
            if self.falls(&region, region[3].high >= stop)? {
                continue;
            }
            let width = |axis: &usize| region[*axis].high - region[*axis].low;
            let axis = (0..4).max_by(|one, other| width(one).total_cmp(&width(other)))?;
            let middle = region[axis].middle();
            let halves = [(region[axis].low, middle), (middle, region[axis].high)];
            open.extend(halves.map(|(low, high)| {
                let mut half = region;
                half[axis] = Interval::between(low, high);
                half
            }));
        }
        None
    }

    /// Whether x'Px is proved to fall in a box; none if it rises in the middle. On the stop both a free
    /// motion and a held one count, unless the steering leaves it.
    fn falls(&self, region: &Region, at_stop: bool) -> Option<bool> {
        let origin = [Interval::ZERO; 4];
        let mut field = Chords::at(&self.states, region, &origin).field(self.closed_loop);
        let is_held = at_stop && !field[3].is_negative();
        let fields = if is_held { 2 } else { 1 };
        let falls = (0..fields).all(|index| {
            if index == 1 {
                field[3] = Chord::from(0.0);
            }
            let form = product(&self.gradient, &field.map(|row| row.slopes));
            let form = from_fn(|i| from_fn(|j| form[i][j] + form[j][i]));
            bound(form, region) < 0.0
        });
        if falls {
            return Some(true);
        }
        let centre = region.map(|y| Interval::exactly(y.middle()));
        let chords = Chords::at(&self.states, region, &centre);
        let mut field = chords.field(self.closed_loop);
        let mut falls = true;
        for index in 0..fields {
            if index == 1 {
                field[3] = Chord::from(0.0);
            }
            let slope = (0..4).fold(Chord::<4>::from(0.0), |slope, i| {
                let row = (0..4).map(|k| chords.0[k] * self.form[(i, k)]);
                slope + row.fold(Chord::from(0.0), |sum, term| sum + term) * field[i]
            });
            if slope.origin.low > 0.0 && bound(self.outside, &centre) > -self.level {
                return None;
            }
            let rest = sum(|k| slope.slopes[k] * (region[k] - centre[k]));
            falls &= (slope.origin + rest).high < 0.0;
        }
        Some(falls)
    }
}

fn sum(term: impl Fn(usize) -> Interval) -> Interval {
    (0..4).fold(Interval::ZERO, |sum, index| sum + term(index))
}

fn product(one: &Square, other: &Square) -> Square {
    from_fn(|i| from_fn(|j| sum(|k| one[i][k] * other[k][j])))
}

/// An upper bound of y'My for all y of a region but zero, and all symmetric M: squares of negative
/// weight are split off, and the least bound of a rest counts. Below zero if M is negative definite.
fn bound(mut form: Square, region: &Region) -> f64 {
    let mut left = [true; 4];
    let mut least = f64::INFINITY;
    loop {
        let mut rest = Interval::ZERO;
        for i in (0..4).filter(|i| left[*i]) {
            rest = rest + form[i][i] * region[i].square();
            for j in (0..i).filter(|j| left[*j]) {
                rest = rest + (form[i][j] + form[i][j]) * region[i] * region[j];
            }
        }
        least = least.min(rest.high);
        let order = |i: &usize, j: &usize| form[*i][*i].high.total_cmp(&form[*j][*j].high);
        let Some(pivot) = (0..4).filter(|i| left[*i]).min_by(order) else {
            return least.min(-f64::MIN_POSITIVE);
        };
        let weight = form[pivot][pivot];
        // Not a number is not negative.
        let is_negative = weight.high < 0.0;
        if !is_negative {
            return least;
        }
        left[pivot] = false;
        for i in (0..4).filter(|i| left[*i]) {
            for j in (0..i).filter(|j| left[*j]) {
                form[i][j] = form[i][j] - form[i][pivot] * form[j][pivot] / weight;
                form[j][i] = form[i][j];
            }
            form[i][i] = form[i][i] - form[i][pivot].square() / weight;
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{SlipAngles, Tyres, VehicleParameters};

    use super::{super::closed_loop::Saturation, *};

    fn at(speed: f64) -> ClosedLoop {
        let law = Law::FrontPoint;
        let ideal = ClosedLoop::new(VehicleParameters::paper(), law, 0.35, speed, 0.0).unwrap();
        let saturation = Saturation {
            tyres: Tyres::Saturating,
            slip_angles: SlipAngles::Exact,
            max_steering: 0.45,
            max_steering_rate: 5.0,
        };
        ideal.saturating(saturation).unwrap()
    }

    /// Left out of `cargo verify`, not of `--all`: it takes seconds of processor time.
    mod thorough {
        use super::*;

        #[test]
        fn a_small_region_is_proved_and_a_form_that_rises_is_not() {
            let at = at(2.0);
            let region = at.attraction(0.01).unwrap().unwrap();
            assert!((region.yaw() - 0.01).abs() < 1e-9);
            let mut other = region.form;
            other[(1, 1)] *= 100.0;
            assert!(
                Proof::new(&at, &other, region.level).is_none_or(|proof| proof.boxes().is_none())
            );
        }
    }
}
