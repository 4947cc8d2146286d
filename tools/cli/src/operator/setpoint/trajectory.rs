//! The file of a trajectory, and the part of it that is sent now.

use std::{fs, path::Path};

use serde::Deserialize;
use singletrack_api::{Setpoint, TrajectoryPoint};

/// Points that are sent at once: in two ticks they are with the pilot.
const WINDOW: usize = 40;

/// The least time of so many points, s: longer than the usual time-out of a set-point.
const LEAST_SPAN: f64 = 0.3;

/// The points of a file, in order of time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TrajectoryFile(Vec<Point>);

/// What to write in a file of either kind.
const CSV: &str = "the first line names the columns t_s,x_m,y_m (and vx_m_s,vy_m_s), the others have a \
                   number for each";
const JSON: &str = "write a list of {\"t_s\":0.0,\"position_m\":[0.0,0.0]}, with \"velocity_m_s\" or \
                    without";

/// A line of a CSV file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    t_s: f64,
    x_m: f64,
    y_m: f64,
    vx_m_s: Option<f64>,
    vy_m_s: Option<f64>,
}

/// A point, as a JSON file has it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    t_s: f64,
    position_m: [f64; 2],
    velocity_m_s: Option<[f64; 2]>,
}

impl TrajectoryFile {
    /// Reads a file: JSON if it begins with a bracket, else CSV.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let text = fs::read_to_string(path)
            .map_err(|error| format!("{error}; give the path of a CSV or JSON file"))?;
        Self::parse(&text)
    }

    fn parse(text: &str) -> Result<Self, String> {
        let written: Vec<Point> = if text.trim_start().starts_with(['[', '{']) {
            serde_json::from_str(text).map_err(|error| format!("{error}; {JSON}"))?
        } else {
            let mut reader = csv::ReaderBuilder::new()
                .trim(csv::Trim::All)
                .comment(Some(b'#'))
                .from_reader(text.as_bytes());
            let rows = reader.deserialize().collect::<Result<Vec<Row>, _>>();
            let rows = rows.map_err(|error| format!("{error}; {CSV}"))?;
            let rows = (1_usize..).zip(rows).map(|(number, row)| {
                if row.vx_m_s.is_some() != row.vy_m_s.is_some() {
                    let how = "write vx_m_s and vy_m_s, or neither";
                    return Err(format!("point {number} has half a velocity; {how}"));
                }
                Ok(Point {
                    t_s: row.t_s,
                    position_m: [row.x_m, row.y_m],
                    velocity_m_s: row.vx_m_s.zip(row.vy_m_s).map(<[f64; 2]>::from),
                })
            });
            rows.collect::<Result<_, _>>()?
        };
        if written.len() < 2 {
            let count = written.len();
            return Err(format!("it has {count} points; write two at least"));
        }
        for (number, point) in (1_usize..).zip(&written) {
            let velocity = point.velocity_m_s.unwrap_or_default();
            let [x, y] = point.position_m;
            let numbers = [point.t_s, x, y].into_iter().chain(velocity);
            if !numbers.into_iter().all(f64::is_finite) {
                return Err(format!("point {number}: write finite numbers"));
            }
        }
        for (number, pair) in (2_usize..).zip(written.windows(2)) {
            if matches!(pair, [before, after] if after.t_s <= before.t_s) {
                return Err(format!(
                    "point {number} is not later than the one before; put the points in order of time"
                ));
            }
        }
        for (number, window) in (1..).zip(written.windows(WINDOW)) {
            if let [first, .., last] = window
                && last.t_s - first.t_s < LEAST_SPAN
            {
                let span = last.t_s - first.t_s;
                let to = number + WINDOW - 1;
                return Err(format!(
                    "points {number} to {to} take {span:.3} s; leave points out, so that 40 take at \
                     least 0.3 s: 100 a second will do"
                ));
            }
        }
        let points = written.iter().enumerate().map(|(index, point)| {
            let before = index.checked_sub(1).and_then(|before| written.get(before));
            let after = written.get(index + 1);
            let between = || slope(before.unwrap_or(point), after.unwrap_or(point));
            Point {
                velocity_m_s: point.velocity_m_s.or_else(|| Some(between())),
                ..*point
            }
        });
        Ok(Self(points.collect()))
    }

    /// The set-point at `now_ns` of a trajectory that began at `begin_ns` with its first point:
    /// that of now and those after it; `None` when the last one is over.
    pub(super) fn window(&self, begin_ns: u64, now_ns: u64) -> Option<Setpoint> {
        let Self(points) = self;
        let first = points.first()?;
        let time_ns = |point: &Point| begin_ns + ((point.t_s - first.t_s) * 1e9) as u64;
        if time_ns(points.last()?) < now_ns {
            return None;
        }
        let over = points.partition_point(|point| time_ns(point) <= now_ns);
        // The curve from the last point that is over goes through now. Two make a trajectory.
        let from = over.saturating_sub(1).min(points.len().saturating_sub(2));
        let window = points.iter().skip(from).take(WINDOW);
        let window = window.map(|point| TrajectoryPoint {
            time_ns: time_ns(point),
            position_m: point.position_m,
            velocity_m_s: point.velocity_m_s.unwrap_or_default(),
        });
        Some(Setpoint {
            trajectory: Some(window.collect()),
            ..Setpoint::default()
        })
    }
}

/// The velocity from one point to another.
fn slope(from: &Point, to: &Point) -> [f64; 2] {
    let ([x, y], [to_x, to_y]) = (from.position_m, to.position_m);
    let time = to.t_s - from.t_s;
    [(to_x - x) / time, (to_y - y) / time]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(setpoint: &Setpoint) -> Vec<u64> {
        let points = setpoint.trajectory.as_ref().unwrap();
        points.iter().map(|point| point.time_ns).collect()
    }

    #[test]
    fn csv_and_json_are_the_same_trajectory_with_the_velocities_between_neighbours() {
        let csv = TrajectoryFile::parse("t_s, x_m, y_m\n2, 0, 0\n3, 1, 0\n5, 1, 2\n").unwrap();
        let json = r#"[{"t_s":2,"position_m":[0,0],"velocity_m_s":[1,0]},
            {"t_s":3,"position_m":[1,0]},{"t_s":5,"position_m":[1,2]}]"#;
        assert_eq!(csv, TrajectoryFile::parse(json).unwrap());
        let velocities: Vec<_> = csv.0.iter().flat_map(|point| point.velocity_m_s).collect();
        assert_eq!(velocities, [[1.0, 0.0], [1.0 / 3.0, 2.0 / 3.0], [0.0, 1.0]]);
        let given = "t_s,vx_m_s,vy_m_s,x_m,y_m\n0,5,6,0,0\n1,7,8,1,1\n";
        let given = TrajectoryFile::parse(given).unwrap();
        assert_eq!(given.0.first().unwrap().velocity_m_s, Some([5.0, 6.0]));
    }

    #[test]
    fn the_points_of_now_and_later_are_sent_until_the_last_is_over() {
        const SECOND: u64 = 1_000_000_000;
        let rows: String = (0..100)
            .map(|t| format!("{},{t},0\n", f64::from(t) + 7.0))
            .collect();
        let way = TrajectoryFile::parse(&format!("t_s,x_m,y_m\n{rows}")).unwrap();
        let begin = 50 * SECOND;
        let sent = |now| way.window(begin, now).map(|keys| times(&keys));
        let from = |first: u64, count: u64| {
            let second = |index| begin + (first + index) * SECOND;
            Some((0..count).map(second).collect::<Vec<_>>())
        };
        assert_eq!(sent(begin - SECOND / 2), from(0, 40));
        assert_eq!(sent(begin), from(0, 40));
        assert_eq!(sent(begin + SECOND), from(1, 40));
        assert_eq!(sent(begin + 2 * SECOND - 1), from(1, 40));
        assert_eq!(sent(begin + 90 * SECOND), from(90, 10));
        assert_eq!(sent(begin + 99 * SECOND), from(98, 2));
        assert_eq!(sent(begin + 99 * SECOND + 1), None);
    }

    #[test]
    fn a_file_that_is_no_trajectory_is_refused_with_what_to_write() {
        let dense: String = (0..40)
            .map(|t| format!("{},0,0\n", 0.007 * f64::from(t)))
            .collect();
        for (text, part) in [
            ("", "it has 0 points; write two"),
            ("t_s,x_m,y_m\n0,0,0\n", "it has 1 points"),
            ("t,x,y\n0,0,0\n1,0,0\n", "names the columns t_s,x_m,y_m"),
            ("t_s,x_m,y_m\n0,0\n", "a number for each"),
            ("t_s,x_m,y_m\n0,0,left\n", "a number for each"),
            ("t_s,x_m,y_m\n0,0,0\n0,1,0\n", "point 2 is not later"),
            ("t_s,x_m,y_m\n0,0,0\n1,inf,0\n", "point 2: write finite"),
            (
                "t_s,x_m,y_m,vx_m_s,vy_m_s\n0,0,0,1,\n",
                "point 1 has half a velocity",
            ),
            ("[{\"t_s\":0}]", "write a list of"),
            (
                &format!("t_s,x_m,y_m\n{dense}"),
                "points 1 to 40 take 0.273 s; leave points out",
            ),
        ] {
            let error = TrajectoryFile::parse(text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
