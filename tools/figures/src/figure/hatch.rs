//! Oblique lines over an area, each with its ends: what every renderer draws alike.

use super::thin::Piece;

/// Distance from line to line, in mm.
const SPACING: f64 = 1.1;

/// The lines over what is in an odd number of the rings, rising to the right.
pub(super) fn hatch(rings: &[Piece]) -> Vec<[[f64; 2]; 2]> {
    // On the page x goes right and y down: along a line x + y stays, x - y grows.
    let step = SPACING * std::f64::consts::SQRT_2;
    let sums = rings.iter().flatten().map(|[x, y]| x + y);
    let [low, high] = sums.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], sum| {
        [low.min(sum), high.max(sum)]
    });
    if low > high {
        return Vec::new();
    }
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
    use super::*;

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
