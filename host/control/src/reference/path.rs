//! A smooth path through points, at a speed under given limits.
//!
//! The path is a cubic spline over the sum of the chords, natural at its ends or periodic.
//! The speed is the highest one within three limits: speed, lateral acceleration, and
//! acceleration along the path. Both are computed once, from the points.

use heapless::Vec;
use libm::{floor, hypot, sqrt};

use super::{ReferenceError, ReferencePoint, positive};
use crate::{Position, Velocity};

/// The largest number of points of a path: it takes no more memory than the waypoints do.
pub const MAX_PATH_POINTS: usize = 400;

/// The least distance between two points in a row, in m. Below it, an error of a millimetre
/// in a point bends the spline.
const LEAST_CHORD: f64 = 0.005;

/// The least radius of a path, in m.
const LEAST_RADIUS: f64 = 0.05;

/// Two ends that are closer than this are one point of a closed path, in m.
const SAME_POINT: f64 = 1e-3;

/// The largest and the smallest number of stretches of the speed profile.
const MAX_STRETCHES: usize = 511;
const MIN_STRETCHES: usize = 64;

/// The length of a stretch where the path is short enough, in m.
const STRETCH: f64 = 0.01;

/// One more for the end of a closed path, which is its start.
const KNOTS: usize = MAX_PATH_POINTS + 1;

/// The limits of a path's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSpeed {
    /// Highest speed of P, in m/s.
    pub speed: f64,
    /// Highest lateral acceleration of P, v² over the radius of its path, in m/s².
    pub lateral_acceleration: f64,
    /// Highest change of the speed, in m/s².
    pub acceleration: f64,
}

/// A point of the spline.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Knot {
    /// The sum of the chords before it, m.
    at: f64,
    position: Velocity,
    /// Second derivative of the position by `at`, 1/m.
    bend: Velocity,
}

/// A station of the speed profile; the stations are equally far apart in `Knot::at`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Station {
    /// When P passes it, s.
    time: f64,
    /// The rate of `Knot::at` there, 1/s.
    pace: f64,
}

/// A smooth path through points.
///
/// An open path begins and ends at rest. A closed path is driven round and round, and begins
/// at rest.
///
/// ```
/// use singletrack_control::{Path, PathSpeed, Position, Reference};
///
/// let points = [(0.0, 0.0), (1.0, 0.1), (2.0, -0.1), (3.0, 0.0)].map(|(x, y)| Position::new(x, y));
/// let limits = PathSpeed { speed: 0.5, lateral_acceleration: 1.0, acceleration: 0.5 };
/// let path = Path::new(&points, false, limits)?;
/// let reference = Reference::Path(path);
/// assert_eq!(reference.at(0.0).position, Some(points[0]));
/// // 3 m at 0.5 m/s, and a second more to speed up and to slow down.
/// assert!(reference.duration().is_some_and(|time| (7.0..7.2).contains(&time)));
/// # Ok::<(), singletrack_control::ReferenceError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    knots: Vec<Knot, KNOTS>,
    stations: Vec<Station, { MAX_STRETCHES + 1 }>,
    /// Distance between stations in `Knot::at`, m.
    stretch: f64,
    /// Time of the run-in of a closed path, s: its first seconds are driven more slowly.
    run_in: f64,
    is_closed: bool,
    /// The time on the lap at which the drive begins, s.
    pub(super) phase: f64,
}

impl Path {
    /// The path through `points` in their order, from the last one back to the first if it
    /// `is_closed`. A last point that repeats the first one of a closed path is left out.
    ///
    /// # Errors
    ///
    /// At least two points, three for a closed path, at most [`MAX_PATH_POINTS`], all finite,
    /// 5 mm apart or more; no bend of a radius below 5 cm; limits above zero.
    pub fn new(
        points: &[Position],
        is_closed: bool,
        limits: PathSpeed,
    ) -> Result<Self, ReferenceError> {
        let limits = PathSpeed {
            speed: positive("speed_m_s", limits.speed)?,
            lateral_acceleration: positive(
                "lateral_acceleration_m_s2",
                limits.lateral_acceleration,
            )?,
            acceleration: positive("acceleration_m_s2", limits.acceleration)?,
        };
        let points = match points {
            [first, middle @ .., last] if is_closed && (last - first).norm() < SAME_POINT => {
                points.get(..=middle.len()).unwrap_or(points)
            }
            _ => points,
        };
        let knots = spline(points, is_closed)?;
        let length = knots.last().map_or(0.0, |knot| knot.at);
        let stretches = (length / STRETCH) as usize;
        let stretches = stretches.clamp(MIN_STRETCHES, MAX_STRETCHES);
        let mut path = Self {
            knots,
            stations: Vec::new(),
            stretch: length / stretches as f64,
            run_in: 0.0,
            is_closed,
            phase: 0.0,
        };
        path.profile(stretches, &limits)?;
        if is_closed {
            let fastest = path
                .stations
                .iter()
                .map(|station| station.pace)
                .fold(0.0, f64::max);
            // The chord is at most as long as the path, so that the pace is near the speed.
            path.run_in = 2.0 * fastest / limits.acceleration;
        }
        Ok(path)
    }

    /// Whether the path ends where it begins and goes on from there.
    pub const fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// The points, in order.
    pub fn points(&self) -> impl Iterator<Item = Position> + '_ {
        let surplus = usize::from(self.is_closed);
        let count = self.knots.len().saturating_sub(surplus);
        let knots = self.knots.iter().take(count);
        knots.map(|knot| Position::from(knot.position))
    }

    /// The time from the first point to the last one, or once round, in s.
    pub fn lap_time(&self) -> f64 {
        self.stations.last().map_or(0.0, |station| station.time)
    }

    pub(super) fn at(&self, time: f64) -> ReferencePoint {
        let (time, rate) = self.since_start(time);
        self.passed_at(time, rate)
    }

    pub(super) fn on_lap(&self, time: f64) -> ReferencePoint {
        self.passed_at(self.wrapped(time), 1.0)
    }

    /// The place that is passed at this time on the lap, at this rate.
    fn passed_at(&self, time: f64, rate: f64) -> ReferencePoint {
        let passed = self
            .stations
            .partition_point(|station| station.time <= time);
        let index = passed.clamp(1, self.stations.len() - 1) - 1;
        let (from, to) = (self.stations[index], self.stations[index + 1]);
        let whole = to.time - from.time;
        let elapsed = (time - from.time).clamp(0.0, whole);
        let change = (to.pace - from.pace) / whole;
        let way = from.pace * elapsed + 0.5 * change * elapsed * elapsed;
        let pace = from.pace + change * elapsed;
        let there = self.spot(index as f64 * self.stretch + way.min(self.stretch));
        let is_over = !self.is_closed && (time > self.lap_time() || time < 0.0);
        ReferencePoint {
            position: Some(Position::from(there.position)),
            velocity: if is_over {
                Velocity::zeros()
            } else {
                pace * rate * there.slope
            },
        }
    }

    /// The time on the lap for a time since the start of the drive, and its rate.
    fn since_start(&self, time: f64) -> (f64, f64) {
        if !self.is_closed {
            return (time, 1.0);
        }
        let time = time.max(0.0);
        let (driven, rate) = if time < self.run_in {
            (0.5 * time * time / self.run_in, time / self.run_in)
        } else {
            (time - 0.5 * self.run_in, 1.0)
        };
        (self.wrapped(self.phase + driven), rate)
    }

    fn wrapped(&self, time: f64) -> f64 {
        let lap = self.lap_time();
        time - lap * floor(time / lap)
    }

    /// Where the spline is at `at`, and how it goes on.
    fn spot(&self, at: f64) -> Spot {
        let passed = self.knots.partition_point(|knot| knot.at <= at);
        let index = passed.clamp(1, self.knots.len() - 1);
        Spot::between(&self.knots[index - 1], &self.knots[index], at)
    }

    /// Computes the stations from the limits.
    fn profile(&mut self, stretches: usize, limits: &PathSpeed) -> Result<(), ReferenceError> {
        // Squares of the speed, m²/s².
        let top = limits.speed * limits.speed;
        let in_bend = |curvature: f64| limits.lateral_acceleration / curvature.max(1e-9);
        let stations = (0..=stretches).map(|station| self.spot(station as f64 * self.stretch));
        let mut squares: Vec<f64, { MAX_STRETCHES + 1 }> = stations
            .map(|spot| top.min(in_bend(spot.curvature())))
            .collect();
        // The second derivative is largest at a knot, which lies between two stations.
        for (index, knot) in self.knots.iter().enumerate() {
            let curvature = self.spot(knot.at).curvature();
            // Where the spline turns back on itself its curvature is no number.
            if curvature.is_nan() || curvature * LEAST_RADIUS > 1.0 {
                return Err(ReferenceError::TooSharp(index, 1.0 / curvature));
            }
            let station = (knot.at / self.stretch) as usize;
            for square in squares.iter_mut().skip(station).take(2) {
                *square = square.min(in_bend(curvature));
            }
        }
        let lengths: Vec<f64, MAX_STRETCHES> =
            (0..stretches).map(|stretch| self.length(stretch)).collect();
        // The acceleration bounds what comes after a stretch by what is before it, and the reverse.
        let after =
            |square: f64, stretch: usize| square + 2.0 * limits.acceleration * lengths[stretch];
        self.join(&mut squares);
        // On a closed path the limits of the start come round from its end: twice.
        let rounds = if self.is_closed { 2 } else { 1 };
        for _ in 0..rounds {
            for index in 0..stretches {
                squares[index + 1] = squares[index + 1].min(after(squares[index], index));
            }
            self.join(&mut squares);
            for index in (0..stretches).rev() {
                squares[index] = squares[index].min(after(squares[index + 1], index));
            }
            self.join(&mut squares);
        }
        let mut time = 0.0;
        for (station, square) in squares.iter().enumerate() {
            let slope = self.spot(station as f64 * self.stretch).slope;
            let pace = sqrt(*square) / hypot(slope.x, slope.y);
            if let Some(before) = self.stations.last() {
                time += 2.0 * self.stretch / (before.pace + pace);
            }
            let _ = self.stations.push(Station { time, pace });
        }
        if time.is_finite() {
            Ok(())
        } else {
            // A spline that stands still somewhere: its points turn back on themselves.
            Err(ReferenceError::TooSharp(0, 0.0))
        }
    }

    /// A closed path's end is its start; an open path begins and ends at rest.
    fn join(&self, squares: &mut [f64]) {
        if let [first, .., last] = squares {
            let both = if self.is_closed {
                first.min(*last)
            } else {
                0.0
            };
            (*first, *last) = (both, both);
        }
    }

    /// Length of the path on a stretch, m; by Simpson's rule.
    fn length(&self, stretch: usize) -> f64 {
        let speed = |part: f64| {
            let slope = self.spot((stretch as f64 + part) * self.stretch).slope;
            hypot(slope.x, slope.y)
        };
        self.stretch * (speed(0.0) + 4.0 * speed(0.5) + speed(1.0)) / 6.0
    }
}

/// A place on the spline.
#[derive(Clone, Copy, Debug, Default)]
struct Spot {
    position: Velocity,
    /// First derivative by the sum of the chords.
    slope: Velocity,
    /// Second derivative, 1/m.
    bend: Velocity,
}

impl Spot {
    fn between(from: &Knot, to: &Knot, at: f64) -> Self {
        let chord = to.at - from.at;
        let share = (at - from.at) / chord;
        let rest = 1.0 - share;
        let third = chord * chord / 6.0;
        Self {
            position: rest * from.position
                + share * to.position
                + third * ((rest * rest * rest - rest) * from.bend)
                + third * ((share * share * share - share) * to.bend),
            slope: (to.position - from.position) / chord
                + chord / 6.0
                    * ((3.0 * share * share - 1.0) * to.bend
                        - (3.0 * rest * rest - 1.0) * from.bend),
            bend: rest * from.bend + share * to.bend,
        }
    }

    fn curvature(&self) -> f64 {
        let length = hypot(self.slope.x, self.slope.y);
        let turn = self.slope.x * self.bend.y - self.slope.y * self.bend.x;
        turn.abs() / (length * length * length)
    }
}

/// The knots of the spline through `points`.
fn spline(points: &[Position], is_closed: bool) -> Result<Vec<Knot, KNOTS>, ReferenceError> {
    let least = if is_closed { 3 } else { 2 };
    if points.len() < least {
        return Err(ReferenceError::TooFew("points", points.len(), least));
    }
    if points.len() > MAX_PATH_POINTS {
        return Err(ReferenceError::TooMany("points", MAX_PATH_POINTS));
    }
    let mut knots: Vec<Knot, KNOTS> = Vec::new();
    let end = points.first().filter(|_| is_closed);
    for (index, point) in points.iter().chain(end).enumerate() {
        super::finite("point x_m", point.x)?;
        super::finite("point y_m", point.y)?;
        let at = match knots.last() {
            None => 0.0,
            Some(before) => {
                let chord = (point.coords - before.position).norm();
                if chord < LEAST_CHORD {
                    return Err(ReferenceError::TooClose(index % points.len(), chord));
                }
                before.at + chord
            }
        };
        let _ = knots.push(Knot {
            at,
            position: point.coords,
            bend: Velocity::zeros(),
        });
    }
    let inner = knots.windows(3).map(row);
    if is_closed {
        let rows = [row_of_start(&knots)].into_iter().chain(inner).collect();
        bend_periodic(&mut knots, rows);
    } else {
        let rows: Vec<Row, KNOTS> = inner.collect();
        for (knot, bend) in knots.iter_mut().skip(1).zip(&solve(&rows)) {
            knot.bend = *bend;
        }
    }
    Ok(knots)
}

/// One equation for the second derivatives: that the first one is continuous at a knot.
#[derive(Clone, Copy, Debug)]
struct Row {
    before: f64,
    here: f64,
    after: f64,
    right: Velocity,
}

/// The equation at the middle one of three knots.
fn row(knots: &[Knot]) -> Row {
    let chord = |from: &Knot, to: &Knot| (to.at - from.at, to.position - from.position);
    let (first, way) = chord(&knots[0], &knots[1]);
    let (second, further) = chord(&knots[1], &knots[2]);
    Row {
        before: first,
        here: 2.0 * (first + second),
        after: second,
        right: 6.0 * (further / second - way / first),
    }
}

/// The equation at the first knot of a closed spline, which has the last but one before it.
fn row_of_start(knots: &[Knot]) -> Row {
    let [before, end] = [knots[knots.len() - 2], knots[knots.len() - 1]];
    let before = Knot {
        at: before.at - end.at,
        ..before
    };
    row(&[before, knots[0], knots[1]])
}

/// Second derivatives of a closed spline, whose last knot is its first: Sherman and Morrison's
/// formula for the two corners of the matrix.
fn bend_periodic(knots: &mut [Knot], mut rows: Vec<Row, KNOTS>) {
    let count = rows.len();
    let (corner, lower) = (rows[0].before, rows[count - 1].after);
    let gamma = -rows[0].here;
    rows[0].here -= gamma;
    rows[count - 1].here -= corner * lower / gamma;
    let bends = solve(&rows);
    for row in &mut rows {
        row.right = Velocity::zeros();
    }
    rows[0].right.x = gamma;
    rows[count - 1].right.x = lower;
    let correction = solve(&rows);
    let ends = |values: &[Velocity]| values[0] + corner / gamma * values[count - 1];
    let factor = ends(&bends) / (1.0 + ends(&correction).x);
    for (index, knot) in knots.iter_mut().enumerate() {
        knot.bend = bends[index % count] - correction[index % count].x * factor;
    }
}

/// The solution of a tridiagonal system that is diagonally dominant.
fn solve(rows: &[Row]) -> Vec<Velocity, KNOTS> {
    let mut upper: Vec<f64, KNOTS> = Vec::new();
    let mut solution: Vec<Velocity, KNOTS> = Vec::new();
    for row in rows {
        let (factor, value) = match (upper.last(), solution.last()) {
            (Some(upper), Some(value)) => (
                row.here - row.before * upper,
                row.right - row.before * value,
            ),
            _ => (row.here, row.right),
        };
        let _ = upper.push(row.after / factor);
        let _ = solution.push(value / factor);
    }
    let mut after = Velocity::zeros();
    for (value, upper) in solution.iter_mut().zip(&upper).rev() {
        *value -= *upper * after;
        after = *value;
    }
    solution
}
