//! A lap of a reference, for the progress along it.

use std::f64::consts::TAU;

use singletrack_control::Reference;

/// Points of a lap.
const LAP_POINTS: usize = 1_000;
/// How far ahead of the last place on the lap the next one is searched, in points.
const SEARCH: usize = 40;

/// A lap of the reference, or its whole way.
pub(super) struct Lap {
    points: Vec<[f64; 2]>,
    /// Way to each point, in m.
    way: Vec<f64>,
    duration: f64,
    closed: bool,
}

impl Lap {
    pub(super) fn new(reference: &Reference) -> Option<Self> {
        let (start, duration, closed) = match reference {
            Reference::Circle(circle) => (0.0, TAU / circle.angular_velocity().abs(), true),
            Reference::FigureOfEight(_) => return None,
            Reference::Path(path) if path.is_closed() => {
                // The first lap begins at rest.
                (path.lap_time(), path.lap_time(), true)
            }
            other => (0.0, other.duration()?, false),
        };
        let points: Vec<[f64; 2]> = (0..=LAP_POINTS)
            .filter_map(|index| {
                let time = start + duration * index as f64 / LAP_POINTS as f64;
                reference.at(time).position.map(|point| [point.x, point.y])
            })
            .collect();
        let mut sum = 0.0;
        let mut way = vec![0.0];
        for pair in points.windows(2) {
            if let [[x0, y0], [x1, y1]] = pair {
                sum += libm::hypot(x1 - x0, y1 - y0);
                way.push(sum);
            }
        }
        (points.len() == LAP_POINTS + 1 && duration.is_finite()).then_some(Self {
            points,
            way,
            duration,
            closed,
        })
    }

    fn length(&self) -> f64 {
        self.way.last().copied().unwrap_or_default()
    }

    /// The time on the reference at a place.
    pub(super) fn time(&self, place: usize) -> f64 {
        self.duration * place as f64 / LAP_POINTS as f64
    }

    /// The place nearest to `point` near `from`, and the distance to it.
    pub(super) fn nearest(&self, [x, y]: [f64; 2], from: usize) -> (usize, f64) {
        let near = || {
            (0..=2 * SEARCH).filter_map(|offset| {
                let at = from + offset + LAP_POINTS - SEARCH / 2;
                let index = if self.closed {
                    at % LAP_POINTS
                } else {
                    (at - LAP_POINTS.min(at)).min(LAP_POINTS)
                };
                let [px, py] = self.points.get(index)?;
                Some((index, [px - x, py - y]))
            })
        };
        let square = |[x, y]: [f64; 2]| x * x + y * y;
        let least = near()
            .map(|(_, way)| square(way))
            .fold(f64::INFINITY, f64::min);
        let mut best = (from, f64::INFINITY);
        for (index, way) in near() {
            // The square is rounded otherwise than the distance, and cheaper.
            if square(way) <= least * (1.0 + 1e-12) {
                let distance = libm::hypot(way[0], way[1]);
                if distance < best.1 {
                    best = (index, distance);
                }
            }
        }
        best
    }

    /// The way from one place to another, in m; at most half of a closed lap.
    pub(super) fn between(&self, from: usize, to: usize) -> f64 {
        let at = |index: usize| self.way.get(index).copied().unwrap_or_default();
        let way = at(to) - at(from);
        let length = self.length();
        if self.closed && way > length / 2.0 {
            way - length
        } else if self.closed && way < -length / 2.0 {
            way + length
        } else {
            way
        }
    }
}
