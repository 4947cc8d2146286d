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
        self.knots
            .iter()
            .take(count)
            .map(|knot| Position::from(knot.position))
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
        let last = self.stations.len().saturating_sub(2);
        let index = self
            .stations
            .partition_point(|station| station.time <= time)
            .saturating_sub(1)
            .min(last);
        let (Some(from), Some(to)) = (self.stations.get(index), self.stations.get(index + 1))
        else {
            return ReferencePoint::default();
        };
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
        let last = self.knots.len().saturating_sub(2);
        let index = self
            .knots
            .partition_point(|knot| knot.at <= at)
            .saturating_sub(1)
            .min(last);
        match (self.knots.get(index), self.knots.get(index + 1)) {
            (Some(from), Some(to)) => Spot::between(from, to, at),
            _ => Spot::default(),
        }
    }

    /// Computes the stations from the limits.
    fn profile(&mut self, stretches: usize, limits: &PathSpeed) -> Result<(), ReferenceError> {
        // Squares of the speed, m²/s².
        let mut squares: Vec<f64, { MAX_STRETCHES + 1 }> = Vec::new();
        let top = limits.speed * limits.speed;
        for station in 0..=stretches {
            let curvature = self.spot(station as f64 * self.stretch).curvature();
            let bend = limits.lateral_acceleration / curvature.max(1e-9);
            let _ = squares.push(top.min(bend));
        }
        // The second derivative is largest at a knot, which lies between two stations.
        for (index, knot) in self.knots.iter().enumerate() {
            let curvature = self.spot(knot.at).curvature();
            // Where the spline turns back on itself its curvature is no number.
            if curvature.is_nan() || curvature * LEAST_RADIUS > 1.0 {
                return Err(ReferenceError::TooSharp {
                    index,
                    radius: 1.0 / curvature,
                });
            }
            let station = (knot.at / self.stretch) as usize;
            for square in squares.iter_mut().skip(station).take(2) {
                *square = square.min(limits.lateral_acceleration / curvature.max(1e-9));
            }
        }
        let lengths: Vec<f64, MAX_STRETCHES> =
            (0..stretches).map(|stretch| self.length(stretch)).collect();
        if !self.is_closed {
            if let Some(first) = squares.first_mut() {
                *first = 0.0;
            }
            if let Some(last) = squares.last_mut() {
                *last = 0.0;
            }
        }
        // On a closed path the limits of the start come round from its end: twice.
        let rounds = if self.is_closed { 2 } else { 1 };
        for _ in 0..rounds {
            self.join(&mut squares);
            for index in 0..stretches {
                limit(&mut squares, &lengths, index, index + 1, index, limits);
            }
            self.join(&mut squares);
            for index in (0..stretches).rev() {
                limit(&mut squares, &lengths, index + 1, index, index, limits);
            }
        }
        self.join(&mut squares);
        let mut time = 0.0;
        let mut before: Option<f64> = None;
        for (station, square) in squares.iter().enumerate() {
            let spot = self.spot(station as f64 * self.stretch);
            let pace = sqrt(*square) / hypot(spot.slope.x, spot.slope.y);
            if let Some(before) = before {
                time += 2.0 * self.stretch / (before + pace);
            }
            before = Some(pace);
            let _ = self.stations.push(Station { time, pace });
        }
        if time.is_finite() {
            Ok(())
        } else {
            // A spline that stands still somewhere: its points turn back on themselves.
            Err(ReferenceError::TooSharp {
                index: 0,
                radius: 0.0,
            })
        }
    }

    /// On a closed path, the end is the start.
    fn join(&self, squares: &mut [f64]) {
        if let (true, [first, .., last]) = (self.is_closed, squares) {
            let both = first.min(*last);
            *first = both;
            *last = both;
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

/// Bounds the square of the speed at `to` by the acceleration from `from`, over a stretch.
fn limit(
    squares: &mut [f64],
    lengths: &[f64],
    from: usize,
    to: usize,
    stretch: usize,
    limits: &PathSpeed,
) {
    if let (Some(from), Some(length)) = (squares.get(from).copied(), lengths.get(stretch))
        && let Some(to) = squares.get_mut(to)
    {
        *to = to.min(from + 2.0 * limits.acceleration * length);
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
        return Err(ReferenceError::TooFew {
            name: "points",
            count: points.len(),
            least,
        });
    }
    if points.len() > MAX_PATH_POINTS {
        return Err(ReferenceError::TooMany {
            name: "points",
            most: MAX_PATH_POINTS,
        });
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
                    return Err(ReferenceError::TooClose {
                        index: index % points.len(),
                        distance: chord,
                    });
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
    if is_closed {
        bend_periodic(&mut knots);
    } else {
        let count = knots.len();
        let inner = 1..count - 1;
        let rows: Vec<Row, KNOTS> = inner
            .map(|index| row(&knots, index - 1, index, index + 1))
            .collect();
        let bends = solve(&rows);
        for (knot, bend) in knots.iter_mut().skip(1).zip(&bends) {
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

/// The equation at the knot `here`, between `before` and `after`.
fn row(knots: &[Knot], before: usize, here: usize, after: usize) -> Row {
    let chord = |from: usize, to: usize| match (knots.get(from), knots.get(to)) {
        (Some(from), Some(to)) => (to.at - from.at, to.position - from.position),
        _ => (1.0, Velocity::zeros()),
    };
    let (first, way) = chord(before, here);
    let (second, further) = chord(here, after);
    Row {
        before: first,
        here: 2.0 * (first + second),
        after: second,
        right: 6.0 * (further / second - way / first),
    }
}

/// Second derivatives of a closed spline, whose last knot is its first: Sherman and Morrison's
/// formula for the two corners of the matrix.
fn bend_periodic(knots: &mut Vec<Knot, KNOTS>) {
    let count = knots.len() - 1;
    let (Some(end), Some(last)) = (
        knots.get(count).map(|knot| knot.at),
        knots.get(count - 1).copied(),
    ) else {
        return;
    };
    // The first knot's equation needs the last one before it.
    let around = [
        Knot {
            at: last.at - end,
            ..last
        },
        knots.first().copied().unwrap_or(last),
        knots.get(1).copied().unwrap_or(last),
    ];
    let mut rows: Vec<Row, KNOTS> = Vec::new();
    let _ = rows.push(row(&around, 0, 1, 2));
    rows.extend((1..count).map(|index| row(knots, index - 1, index, index + 1)));
    let (Some(corner), Some(lower)) = (
        rows.first().map(|row| row.before),
        rows.last().map(|row| row.after),
    ) else {
        return;
    };
    let gamma = -rows.first().map_or(1.0, |row| row.here);
    if let Some(first) = rows.first_mut() {
        first.here -= gamma;
    }
    if let Some(last) = rows.last_mut() {
        last.here -= corner * lower / gamma;
    }
    let bends = solve(&rows);
    for (index, row) in rows.iter_mut().enumerate() {
        row.right = match index {
            0 => Velocity::new(gamma, 0.0),
            index if index + 1 == count => Velocity::new(lower, 0.0),
            _ => Velocity::zeros(),
        };
    }
    let correction = solve(&rows);
    let ends = |values: &[Velocity]| match values {
        [first, .., last] => first + corner / gamma * last,
        _ => Velocity::zeros(),
    };
    let factor = ends(&bends) / (1.0 + ends(&correction).x);
    for (index, knot) in knots.iter_mut().enumerate() {
        let index = index % count;
        if let (Some(bend), Some(correction)) = (bends.get(index), correction.get(index)) {
            knot.bend = bend - correction.x * factor;
        }
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
