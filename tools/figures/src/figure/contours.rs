//! Where a grid reaches a value, on the page: rings around areas, lines, and hatching.

use contour::contour_rings;

use super::{Grid, place::between, scale::Ruler, thin::Piece};

/// Stands for not a number: below every threshold.
const BLANK: f64 = -1e300;
/// Stands for infinity, since between two infinities there is no place.
const FAR: f64 = 1e290;

/// Halvings of the way between two neighbours: to less than can be seen.
const HALVINGS: u32 = 6;

/// A grid on the page.
pub(super) struct Sheet {
    grid: Grid,
    /// Where its columns and rows are, in mm.
    x: Vec<f64>,
    y: Vec<f64>,
    /// Finite, row by row.
    values: Vec<f64>,
}

/// A point of a ring, and whether the value is reached there; else the grid ends there.
type Crossing = ([f64; 2], bool);

impl Sheet {
    pub(super) fn new(grid: &Grid, x: &Ruler, y: &Ruler) -> Self {
        let finite = |value: &f64| match value.is_nan() {
            true => BLANK,
            false => value.clamp(-FAR, FAR),
        };
        Self {
            x: grid.x().iter().map(|value| x.at(*value)).collect(),
            y: grid.y().iter().map(|value| y.at(*value)).collect(),
            values: grid.values().iter().map(finite).collect(),
            grid: grid.clone(),
        }
    }

    /// The area of the values from one up to another, as rings: what is in an odd
    /// number of them is in the area.
    pub(super) fn area(&self, from: f64, to: f64) -> Vec<Piece> {
        let mut rings = self.rings(from);
        if to < f64::INFINITY {
            rings.append(&mut self.rings(to));
        }
        let places = |ring: Vec<Crossing>| ring.into_iter().map(|(place, _)| place).collect();
        rings.into_iter().map(places).collect()
    }

    /// The lines along which the value is reached. One that returns to its first point
    /// ends there.
    pub(super) fn lines(&self, value: f64) -> Vec<Piece> {
        let mut lines = Vec::new();
        let places = |piece: &[Crossing]| piece.iter().map(|(place, _)| *place).collect();
        for mut ring in self.rings(value) {
            let Some(end) = ring.iter().position(|(_, reached)| !reached) else {
                lines.push(places(&ring));
                continue;
            };
            // The last point is the first again.
            ring.pop();
            let end = end.min(ring.len());
            ring.rotate_left(end);
            lines.extend(ring.split(|(_, reached)| !reached).map(places));
        }
        lines.retain(|line: &Piece| line.len() > 1);
        lines
    }

    /// Rings around where the values are `threshold` or more, at the edge of the grid
    /// and of what is blank as well.
    fn rings(&self, threshold: f64) -> Vec<Vec<Crossing>> {
        let threshold = threshold.max(-FAR);
        // The grid's constructor has seen to the only error, a wrong number of values.
        let rings = contour_rings(&self.values, threshold, self.x.len(), self.y.len());
        let rings = rings.unwrap_or_default().into_iter().map(|ring| {
            let points = ring.iter();
            let points = points.filter_map(|point| self.crossing(point.x, point.y, threshold));
            points.collect()
        });
        rings.collect()
    }

    /// The point of a ring that lies halfway between two neighbours of the grid, whose
    /// nodes are at 0.5, 1.5 and so on; moved to where the threshold is between them.
    fn crossing(&self, x: f64, y: f64, threshold: f64) -> Option<Crossing> {
        let node = |x: f64, y: f64| self.node((x - 0.5).round(), (y - 0.5).round());
        let ends = if x.fract() == 0.0 {
            [node(x - 0.5, y), node(x + 0.5, y)]
        } else {
            [node(x, y - 0.5), node(x, y + 0.5)]
        };
        match ends {
            [Some((from, low)), Some((to, high))] => {
                let ends = [from, to].map(|node| self.place(node));
                let part = match &self.grid.is_reached {
                    None => (threshold - low) / (high - low),
                    Some(is_reached) => {
                        let ends = [from, to].map(|[x, y]| [self.grid.x()[x], self.grid.y()[y]]);
                        let reached = |part| is_reached(between(ends, part), threshold);
                        halved(|part| reached(part) == (high < threshold))
                    }
                };
                Some((between(ends, part), true))
            }
            [Some((node, _)), None] | [None, Some((node, _))] => Some((self.place(node), false)),
            [None, None] => None,
        }
    }

    /// Where a node is on the page.
    fn place(&self, [column, row]: [usize; 2]) -> [f64; 2] {
        [self.x[column], self.y[row]]
    }

    /// Column, row and value of a node, if there is one.
    fn node(&self, column: f64, row: f64) -> Option<([usize; 2], f64)> {
        if column < 0.0 || row < 0.0 || column >= self.x.len() as f64 {
            return None;
        }
        let (column, row) = (column as usize, row as usize);
        let value = *self.values.get(row * self.x.len() + column)?;
        (value > BLANK).then_some(([column, row], value))
    }
}

/// Where, from 0 to 1, something ends that begins at 0.
fn halved(goes_on: impl Fn(f64) -> bool) -> f64 {
    let mut ends = [0.0, 1.0];
    for _ in 0..HALVINGS {
        let middle = 0.5 * (ends[0] + ends[1]);
        ends[usize::from(!goes_on(middle))] = middle;
    }
    0.5 * (ends[0] + ends[1])
}

/// Distance from line to line, in mm.
const SPACING: f64 = 1.1;

/// The lines over what is in an odd number of the rings, rising to the right.
pub(super) fn hatch(rings: &[Piece]) -> Vec<[[f64; 2]; 2]> {
    // On the page x goes right and y down: along a line x + y stays, x - y grows.
    let step = SPACING * std::f64::consts::SQRT_2;
    let sums = || rings.iter().flatten().map(|[x, y]| x + y);
    let Some((low, high)) = sums().reduce(f64::min).zip(sums().reduce(f64::max)) else {
        return Vec::new();
    };
    // The same lines wherever the area begins, so that neighbours continue each other.
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    let mut lines = Vec::new();
    for index in first..=last {
        let sum = index as f64 * step;
        let mut along: Vec<f64> = rings.iter().flat_map(|ring| cuts(ring, sum)).collect();
        along.sort_by(f64::total_cmp);
        for pair in along.chunks_exact(2) {
            let place = |along: f64| [0.5 * (sum + along), 0.5 * (sum - along)];
            if let [from, to] = *pair {
                lines.push([place(from), place(to)]);
            }
        }
    }
    lines
}

/// Where a ring crosses the line of equal x + y, as x - y.
fn cuts(ring: &Piece, sum: f64) -> impl Iterator<Item = f64> + '_ {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).filter_map(move |(from, to)| {
        let (low, high) = (from[0] + from[1] - sum, to[0] + to[1] - sum);
        // A corner on the line belongs to one of its two edges.
        if (low < 0.0) == (high < 0.0) {
            return None;
        }
        let part = low / (low - high);
        let (start, end) = (from[0] - from[1], to[0] - to[1]);
        Some(start + part * (end - start))
    })
}

#[cfg(test)]
mod tests {
    use super::super::Scale;

    use super::*;

    /// A function on 0 to 4 times 0 to 2, in mm of the same numbers.
    fn sheet(value: impl FnMut(f64, f64) -> f64) -> Sheet {
        let axis = |count: i32| (0..=count).map(|index| f64::from(index) * 0.5).collect();
        let grid = Grid::of(axis(8), axis(4), value).unwrap();
        let ruler = |end| Ruler::new(Scale::Linear, [0.0, end], [0.0, end]);
        Sheet::new(&grid, &ruler(4.0), &ruler(2.0))
    }

    /// The area of a ring less the others, which are within it.
    fn area(rings: &[Piece]) -> f64 {
        let ring = |ring: &Piece| -> f64 {
            let edges = ring.windows(2);
            edges
                .map(|ends| 0.5 * (ends[0][0] * ends[1][1] - ends[1][0] * ends[0][1]))
                .sum()
        };
        let others: f64 = rings.iter().skip(1).map(|other| ring(other).abs()).sum();
        rings.first().map_or(0.0, |first| ring(first).abs()) - others
    }

    #[test]
    fn a_linear_function_is_reached_exactly_and_to_the_edge() {
        let sheet = sheet(|x, y| x + y);
        let lines = sheet.lines(2.25);
        assert_eq!(lines.len(), 1);
        for [x, y] in &lines[0] {
            assert!((x + y - 2.25).abs() < 1e-12);
        }
        let ends = [lines[0][0], lines[0][lines[0].len() - 1]];
        assert!(
            ends.contains(&[0.25, 2.0]) && ends.contains(&[2.25, 0.0]),
            "{ends:?}"
        );
    }

    #[test]
    fn areas_between_values_are_as_large_as_they_should_be() {
        let sheet = sheet(|x, y| x + y);
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        assert!((area(&sheet.area(all[0], all[1])) - 8.0).abs() < 1e-12);
        assert!((area(&sheet.area(all[0], 2.0)) - 2.0).abs() < 1e-12);
        assert!((area(&sheet.area(2.0, 4.0)) - 4.0).abs() < 1e-12);
        assert!(sheet.area(7.0, all[1]).is_empty());
    }

    #[test]
    fn a_round_hill_has_closed_lines() {
        let sheet = sheet(|x, y| -(x - 2.0).hypot(y - 1.0));
        let lines = sheet.lines(-0.75);
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0][0], lines[0][lines[0].len() - 1]);
    }

    #[test]
    fn a_constant_has_no_line_and_is_wholly_in_its_band() {
        let sheet = sheet(|_, _| 3.0);
        assert!(sheet.lines(3.0).is_empty() && sheet.lines(2.0).is_empty());
        assert!((area(&sheet.area(3.0, 4.0)) - 8.0).abs() < 1e-12);
        assert!(
            sheet.area(2.0, 3.0).len() == 2,
            "the ring and itself: nothing"
        );
        assert!(area(&[sheet.area(2.0, 3.0)[0].clone()]) > 7.9);
    }

    #[test]
    fn what_is_not_a_number_is_in_no_area_and_has_no_line_around_it() {
        let sheet = sheet(|x, _| if x < 1.6 { f64::NAN } else { x });
        let all = sheet.area(f64::NEG_INFINITY, f64::INFINITY);
        assert!((area(&all) - 4.0).abs() < 1e-12, "from x = 2 on");
        assert!(sheet.lines(1.0).is_empty());
        let line = &sheet.lines(3.25)[0];
        assert!(line.iter().all(|[x, _]| (x - 3.25).abs() < 1e-12));
    }

    #[test]
    fn a_jump_is_where_it_is_and_not_where_its_neighbours_make_it() {
        let hill = |x: f64, y: f64| if x + y < 2.6 { 60.0 } else { 0.0 };
        let mut sheet = sheet(hill);
        sheet.grid = sheet
            .grid
            .bisected(move |[x, y], value| hill(x, y) >= value);
        for value in [0.1, 10.0] {
            for [x, y] in &sheet.lines(value)[0] {
                assert!((x + y - 2.6).abs() < 0.005, "{x} {y}");
            }
        }
    }

    #[test]
    fn infinity_is_more_than_any_value_and_has_a_place() {
        let sheet = sheet(|x, _| if x > 2.9 { f64::INFINITY } else { x });
        let more = sheet.area(100.0, f64::INFINITY);
        assert!(
            more.iter()
                .flatten()
                .all(|[x, y]| x.is_finite() && y.is_finite())
        );
        assert!((area(&more) - 3.0).abs() < 1e-6);
    }

    fn square(low: f64, high: f64) -> Piece {
        vec![
            [low, low],
            [high, low],
            [high, high],
            [low, high],
            [low, low],
        ]
    }

    fn length(lines: &[[[f64; 2]; 2]]) -> f64 {
        let lengths = lines.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1]));
        lengths.sum()
    }

    #[test]
    fn lines_cover_the_area_at_their_spacing_and_leave_holes_free() {
        let whole = length(&hatch(&[square(0.0, 30.0)]));
        assert!((whole * SPACING - 900.0).abs() < 20.0, "{whole}");
        let ring = hatch(&[square(0.0, 30.0), square(10.0, 20.0)]);
        assert!((length(&ring) * SPACING - 800.0).abs() < 20.0);
        for [from, to] in ring {
            let middle = [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])];
            assert!(!middle.iter().all(|value| (10.1..19.9).contains(value)));
        }
    }

    #[test]
    fn nothing_has_no_lines() {
        assert!(hatch(&[]).is_empty() && hatch(&[vec![]]).is_empty());
    }
}
