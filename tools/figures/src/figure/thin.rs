//! As many points as can be seen, and no more.

/// A piece of a line without a gap.
pub(super) type Piece = Vec<[f64; 2]>;

/// The pieces between points that are not numbers.
pub(super) fn pieces(points: impl Iterator<Item = [f64; 2]>) -> Vec<Piece> {
    let points: Piece = points.collect();
    let is_gap = |[x, y]: &[f64; 2]| !(x.is_finite() && y.is_finite());
    let pieces = points.split(is_gap).filter(|piece| !piece.is_empty());
    pieces.map(<[_]>::to_vec).collect()
}

/// First, lowest, highest and last of the points in each column of `width`, for a
/// line that only goes to the right: all that can be seen of it.
pub(super) fn envelope(points: &[[f64; 2]], width: f64) -> Piece {
    let mut kept = Piece::new();
    for column in
        points.chunk_by(|[one, _], [other, _]| (one / width).floor() == (other / width).floor())
    {
        let by_height = |one: &&[f64; 2], other: &&[f64; 2]| one[1].total_cmp(&other[1]);
        let lowest = column.iter().min_by(by_height);
        let highest = column.iter().max_by(by_height);
        let four = [column.first(), lowest, highest, column.last()];
        let mut four: Vec<_> = four.into_iter().flatten().copied().collect();
        four.sort_by(|[one, _], [other, _]| one.total_cmp(other));
        four.dedup();
        kept.append(&mut four);
    }
    kept
}

/// What the points of a piece look like within `tolerance`: none that is left out
/// is farther than this from the line through the others (Ramer, Douglas, Peucker).
/// Peaks stay, however short.
pub(super) fn thin(points: &[[f64; 2]], tolerance: f64) -> Piece {
    let end = points.len().saturating_sub(1);
    let mut kept = vec![0, end];
    let mut todo = vec![(0, end)];
    while let Some((first, last)) = todo.pop() {
        let (Some(from), Some(to)) = (points.get(first), points.get(last)) else {
            continue;
        };
        let between = points.get(first + 1..last).unwrap_or_default();
        let farthest = (first + 1..)
            .zip(between)
            .map(|(index, point)| (index, distance(*point, *from, *to)))
            .max_by(|one, other| one.1.total_cmp(&other.1));
        if let Some((index, distance)) = farthest
            && distance > tolerance
        {
            kept.push(index);
            todo.extend([(first, index), (index, last)]);
        }
    }
    kept.sort_unstable();
    kept.dedup();
    let kept = kept.into_iter();
    kept.filter_map(|index| points.get(index).copied())
        .collect()
}

/// From a point to the stretch between two others.
fn distance([x, y]: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let (along_x, along_y) = (to[0] - from[0], to[1] - from[1]);
    let (off_x, off_y) = (x - from[0], y - from[1]);
    let square = along_x * along_x + along_y * along_y;
    let part = match square > 0.0 {
        true => ((off_x * along_x + off_y * along_y) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    (off_x - part * along_x).hypot(off_y - part * along_y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_ends_a_piece() {
        let points = [[0.0, 1.0], [1.0, f64::NAN], [2.0, 1.0], [3.0, 1.0]];
        let pieces = pieces(points.into_iter());
        assert_eq!(pieces, [vec![[0.0, 1.0]], vec![[2.0, 1.0], [3.0, 1.0]]]);
    }

    #[test]
    fn the_envelope_of_noise_has_its_extremes_and_few_points() {
        let noise = |index: u32| f64::from(index.wrapping_mul(2_654_435_761) >> 8);
        let points: Vec<_> = (0..60_000)
            .map(|index| [f64::from(index) * 1e-3, noise(index)])
            .collect();
        let kept = envelope(&points, 0.1);
        assert!(kept.len() <= 4 * 600, "{}", kept.len());
        assert!(kept.is_sorted_by(|one, other| one[0] < other[0]));
        let highest = |points: &[[f64; 2]]| points.iter().map(|point| point[1]).fold(0.0, f64::max);
        assert_eq!(highest(&kept), highest(&points));
        assert_eq!((kept[0], kept[kept.len() - 1]), (points[0], points[59_999]));
    }

    #[test]
    fn a_straight_line_needs_its_ends_and_a_peak_stays() {
        let mut points: Vec<_> = (0..1000).map(|index| [f64::from(index), 0.0]).collect();
        assert_eq!(thin(&points, 0.01), [[0.0, 0.0], [999.0, 0.0]]);
        points[500][1] = 5.0;
        assert!(thin(&points, 0.01).contains(&[500.0, 5.0]));
        assert_eq!(thin(&points[..1], 0.01), [[0.0, 0.0]]);
        assert_eq!(thin(&[], 0.01), [[0.0; 2]; 0]);
    }

    #[test]
    fn a_circle_stays_one() {
        let circle: Vec<_> = (0..=10_000)
            .map(|index| f64::from(index) * 1e-3)
            .map(|angle| [30.0 * angle.cos(), 30.0 * angle.sin()])
            .collect();
        let thinned = thin(&circle, 0.02);
        assert!(thinned.len() < 400, "{}", thinned.len());
        for point in &circle {
            let nearest = thinned
                .windows(2)
                .map(|ends| distance(*point, ends[0], ends[1]))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest <= 0.02);
        }
    }
}
