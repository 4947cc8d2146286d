//! Common parts of all figures of a car under a law.

use singletrack_analysis::stability::{
    ClosedLoop, HopfPoint, Law, StabilityError, infinite_speed_limit,
};
use singletrack_figures::figure::{
    Axis, Band, Column, Curve, Grid, GridError, Level, Look, Shade, Symbol,
};

use super::super::{Grid as Deviations, Subject};

/// A car under a law, with what is drawn into every map of it: the Hopf curve and the
/// ends of the physically meaningful range.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The law, as in "under the proposed law".
    pub(super) law: &'static str,
    /// The physically meaningful range of dl, in m.
    meaningful: [f64; 2],
    /// The Hopf points at which stability ends, in branches of ascending speed.
    pub(super) branches: Vec<Vec<HopfPoint>>,
    /// The limit of the Hopf curve for large speeds, as dl in m.
    pub(super) limits: Vec<f64>,
}

pub(super) const SPEED: Axis = Axis::new("speed", Some(Symbol::new("v", "")), "m/s");
pub(super) const DEVIATION: Axis = Axis::new("deviation", Some(Symbol::new("dl", "")), "m");

impl Scene {
    /// The scene of a car under a law, with its Hopf points by speed and then by dl. Those at
    /// which stability does not end, as it is lost already, are not drawn.
    ///
    /// # Errors
    ///
    /// A car without a steady motion.
    pub fn new(subject: &Subject, hopf: &[HopfPoint]) -> Result<Self, StabilityError> {
        let (law, limits) = match subject.law {
            Law::FrontPoint => (
                "the proposed law",
                infinite_speed_limit(subject.vehicle, subject.point_distance)?,
            ),
            Law::VelocityPoint => ("the law of the appendix", Vec::new()),
        };
        Ok(Self {
            law,
            meaningful: ClosedLoop::meaningful_deviations(&subject.vehicle),
            branches: branches(hopf),
            limits,
        })
    }

    /// The Hopf curve within a frame, a curve for each branch.
    pub(super) fn hopf_curves<'a>(&'a self, frame: &'a Frame) -> impl Iterator<Item = Curve> + 'a {
        self.branches.iter().map(|branch| {
            let points = || branch.iter().filter(|point| frame.holds(at(point)));
            Curve {
                name: "Hopf points",
                look: Look::Boundary,
                x: points().map(|point| point.speed).collect(),
                y: points().map(|point| point.deviation).collect(),
                time: None,
            }
        })
    }

    /// The ends of the physically meaningful range.
    pub(super) fn range_ends(&self) -> Vec<Level> {
        let [low, high] = self.meaningful;
        [(low, "−$l_f$"), (high, "$l_r$")]
            .into_iter()
            .map(|(value, label)| Level {
                label: label.to_owned(),
                ..Level::new("physically meaningful range", value, Look::RangeEnd)
            })
            .collect()
    }
}

/// The deviations that a figure of stability shows: the physically meaningful ones
/// with a margin, and for the front-point law as far down as its bifurcations lie.
pub fn drawn_deviations(subject: &Subject, count: usize) -> Deviations {
    let usual = subject.usual_deviations();
    let lowest = usual.values().first().copied().unwrap_or(f64::INFINITY);
    let [low, high] = ends_around_meaningful(subject);
    Deviations::spanning([low.min(lowest), high], count)
}

/// The physically meaningful deviations with a margin: what a figure of the sampled
/// loop shows.
pub fn around_meaningful(subject: &Subject, count: usize) -> Deviations {
    Deviations::spanning(ends_around_meaningful(subject), count)
}

fn ends_around_meaningful(subject: &Subject) -> [f64; 2] {
    let [low, high] = ClosedLoop::meaningful_deviations(&subject.vehicle);
    let wheelbase = subject.vehicle.wheelbase_m();
    // Above, the curve of the velocity-point law goes on.
    [low - 0.3 * wheelbase, high + 0.5 * wheelbase]
}

/// Speed and dl of a Hopf point.
pub(super) const fn at(point: &HopfPoint) -> [f64; 2] {
    [point.speed, point.deviation]
}

/// Points of neighbouring speeds that are near each other belong to one branch.
fn branches(hopf: &[HopfPoint]) -> Vec<Vec<HopfPoint>> {
    let mut done: Vec<Vec<HopfPoint>> = Vec::new();
    let mut open: Vec<Vec<HopfPoint>> = Vec::new();
    for of_a_speed in hopf.chunk_by(|one, other| one.speed == other.speed) {
        let mut points: Vec<HopfPoint> = of_a_speed.to_vec();
        points.retain(HopfPoint::ends_stability);
        let mut going_on = Vec::new();
        while let Some((branch, point)) = nearest(&open, &points) {
            let mut branch = open.swap_remove(branch);
            branch.push(points.swap_remove(point));
            going_on.push(branch);
        }
        done.append(&mut open);
        going_on.extend(points.into_iter().map(|point| vec![point]));
        open = going_on;
    }
    done.append(&mut open);
    done
}

/// The branch and the point that are nearest to each other, by their numbers.
fn nearest(branches: &[Vec<HopfPoint>], points: &[HopfPoint]) -> Option<(usize, usize)> {
    let pairs = branches.iter().enumerate().flat_map(|(branch, of_branch)| {
        points.iter().enumerate().map(move |(index, point)| {
            let last = of_branch
                .last()
                .map(|last| last.deviation - point.deviation);
            (last.map_or(f64::INFINITY, f64::abs), branch, index)
        })
    });
    let nearest = pairs.min_by(|one, other| one.0.total_cmp(&other.0));
    nearest.map(|(_, branch, point)| (branch, point))
}

/// The rectangle that a grid covers.
pub(super) struct Frame {
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    pub(super) fn of(grid: &Grid) -> Self {
        let ends = |values: &[f64]| match (values.first(), values.last()) {
            (Some(first), Some(last)) => [*first, *last],
            _ => [0.0; 2],
        };
        Self {
            x: ends(grid.x()),
            y: ends(grid.y()),
        }
    }

    pub(super) fn holds(&self, [x, y]: [f64; 2]) -> bool {
        (self.x[0]..=self.x[1]).contains(&x) && self.holds_deviation(y)
    }

    pub(super) fn holds_deviation(&self, y: f64) -> bool {
        (self.y[0]..=self.y[1]).contains(&y)
    }

    /// From one point to another, in parts of the frame's sides.
    pub(super) fn distance(&self, from: [f64; 2], to: [f64; 2]) -> f64 {
        let x = (to[0] - from[0]) / (self.x[1] - self.x[0]);
        let y = (to[1] - from[1]) / (self.y[1] - self.y[0]);
        x.hypot(y)
    }
}

/// A value of rows that go over all dl at one speed, then at the next.
pub(super) fn grid_of<R>(
    rows: &[R],
    at: impl Fn(&R) -> [f64; 2],
    value: impl Fn(&R) -> f64,
) -> Result<Grid, GridError> {
    let columns: Vec<&[R]> = rows
        .chunk_by(|one, other| at(one)[0] == at(other)[0])
        .collect();
    let speeds: Column = columns
        .iter()
        .filter_map(|column| column.first())
        .map(|row| at(row)[0])
        .collect();
    let first = columns.first().copied().unwrap_or_default();
    let deviations: Column = first.iter().map(|row| at(row)[1]).collect();
    let along = |index: usize| columns.iter().filter_map(move |column| column.get(index));
    let values = (0..first.len()).flat_map(|index| along(index).map(&value));
    let values: Column = values.collect();
    Grid::new(speeds, deviations, values)
}

pub(super) fn band(from: f64, to: f64, shade: Shade, name: &str) -> Band {
    Band {
        name: name.to_owned(),
        from,
        to,
        shade,
    }
}

#[cfg(test)]
mod tests {
    use singletrack_analysis::stability::{Belief, Lyapunov, hopf_points};
    use singletrack_control::VehicleParameters;

    use super::*;

    fn point(speed: f64, deviation: f64, other: f64) -> HopfPoint {
        HopfPoint {
            speed,
            deviation,
            angular_frequency: 1.0,
            lyapunov: Lyapunov {
                kuznetsov: 1.0,
                matcont: 1.0,
            },
            crossing: 1.0,
            largest_other_real_part: other,
        }
    }

    #[test]
    fn points_are_joined_with_the_nearest_of_the_speed_before() {
        let hopf = [
            point(1.0, 0.3, -1.0),
            point(2.0, -0.5, -1.0),
            point(2.0, 0.32, -1.0),
            point(3.0, -0.45, -1.0),
            point(3.0, 0.4, 2.0),
        ];
        let branches = branches(&hopf);
        let deviations: Vec<Vec<f64>> = branches
            .iter()
            .map(|branch| branch.iter().map(|point| point.deviation).collect())
            .collect();
        assert!(deviations.contains(&vec![-0.5, -0.45]), "{deviations:?}");
        assert!(deviations.contains(&vec![0.3, 0.32]), "{deviations:?}");
        assert_eq!(deviations.len(), 2, "what is lost already is not drawn");
    }

    #[test]
    fn rows_over_dl_become_columns_of_a_grid() {
        let rows = [
            [1.0, -0.1, 10.0],
            [1.0, 0.1, 11.0],
            [2.0, -0.1, 20.0],
            [2.0, 0.1, 21.0],
        ];
        let grid = grid_of(&rows, |row| [row[0], row[1]], |row| row[2]).unwrap();
        assert_eq!((grid.x(), grid.y()), (&[1.0, 2.0][..], &[-0.1, 0.1][..]));
        assert_eq!(grid.values(), [10.0, 20.0, 11.0, 21.0]);
        assert!(grid_of(&rows[..3], |row| [row[0], row[1]], |row| row[2]).is_err());
    }

    #[test]
    fn the_papers_car_has_one_branch_under_each_law() {
        for law in [Law::FrontPoint, Law::VelocityPoint] {
            let subject = Subject {
                vehicle: VehicleParameters::paper(),
                law,
                belief: Belief::CentreOfMass,
                point_distance: 0.35,
            };
            let hopf: Vec<HopfPoint> = (1..=80)
                .flat_map(|tenth| {
                    let (vehicle, belief) = (subject.vehicle, subject.belief);
                    hopf_points(vehicle, law, belief, 0.35, 0.1 * f64::from(tenth)).unwrap()
                })
                .collect();
            let scene = Scene::new(&subject, &hopf).unwrap();
            assert_eq!(scene.branches.len(), 1, "{law:?}");
            assert_eq!(scene.branches[0].len(), 80);
        }
    }
}
