//! The isolines of a map, and the format of its numbers.

use singletrack_figures::figure::{Grid, Isoline, decimals, superscript};

/// The largest number of isolines.
const MOST_ISOLINES: usize = 9;

/// Two significant digits, as a power of ten where zeros are many.
pub(super) fn significant(value: f64) -> String {
    let text = format!("{value:.1e}");
    let parts = text.split_once('e');
    let small = value != 0.0 && value.abs() < 1e-3;
    match parts {
        Some((factor, power)) if small => {
            let raised = superscript(power);
            format!("{}·10{raised}", factor.replace('-', "−"))
        }
        _ => Isoline::new(value, decimals(value) + 1).label,
    }
}

/// Lines at 1, 2, 5, 10 and so on between two values.
pub(super) fn margins(grid: &Grid, [least, limit]: [f64; 2]) -> Vec<Isoline> {
    let mut candidates = sizes();
    candidates.retain(|size| *size >= least && *size < limit);
    chosen(grid, &candidates, 0.0, decimals)
}

/// 1, 2, 5, 10 and so on.
fn sizes() -> Vec<f64> {
    (-3..=4)
        .flat_map(|power| [1.0, 2.0, 5.0].map(|factor| factor * 10_f64.powi(power)))
        .collect()
}

/// Lines at 1, 2, 5, 10 and so on, above and below zero.
pub(super) fn one_two_five(grid: &Grid) -> Vec<Isoline> {
    let sizes = sizes();
    let below = sizes.iter().rev().map(|size| -size);
    let candidates: Vec<f64> = below.chain(sizes.iter().copied()).collect();
    chosen(grid, &candidates, 0.0, decimals)
}

/// Lines near and far from one, by their distance from it.
pub(super) fn around_one(grid: &Grid) -> Vec<Isoline> {
    let distances = [0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
    let below = distances.iter().map(|distance| 1.0 - distance);
    let above = distances.iter().rev().map(|distance| 1.0 + distance);
    let candidates: Vec<f64> = below.chain(above).collect();
    let mut isolines = chosen(grid, &candidates, 1.0, |value| decimals(value - 1.0));
    isolines.push(Isoline::new(1.0, 0));
    isolines
}

/// The ascending candidates that divide the grid best: without almost empty
/// bands between two of them or at the boundary, and not too many; with this many decimals.
fn chosen(
    grid: &Grid,
    candidates: &[f64],
    boundary: f64,
    decimals_of: fn(f64) -> usize,
) -> Vec<Isoline> {
    let mut sorted: Vec<f64> = grid
        .values()
        .iter()
        .copied()
        .filter(|value| !value.is_nan())
        .collect();
    sorted.sort_by(f64::total_cmp);
    let below = |value: f64| {
        sorted.partition_point(|other| *other < value) as f64 / sorted.len().max(1) as f64
    };
    let mut chosen: Vec<f64> = Vec::new();
    let gap = 1.0 / (MOST_ISOLINES as f64 + 2.0);
    // The boundary is drawn anyway.
    let edge = below(boundary);
    let mut last = 0.0;
    for candidate in candidates.iter().copied() {
        let part = below(candidate);
        let apart = (part - edge).abs() >= 0.3 * gap || edge == 0.0 || edge == 1.0;
        if part - last >= 0.5 * gap && part <= 1.0 - 0.25 * gap && apart {
            chosen.push(candidate);
            last = part;
        }
    }
    // Of too many, every other one is dropped.
    while chosen.len() > MOST_ISOLINES {
        let mut index = 0;
        chosen.retain(|_| {
            index += 1;
            index % 2 == 1
        });
    }
    let isolines = chosen.into_iter();
    isolines
        .map(|value| Isoline::new(value, decimals_of(value)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(value: impl Fn(f64) -> f64) -> Grid {
        let x = (0..101).map(|index| f64::from(index) * 0.01).collect();
        Grid::of(x, [0.0, 1.0].into(), |x, _| value(x)).unwrap()
    }

    fn labels(isolines: Vec<Isoline>) -> Vec<String> {
        isolines.into_iter().map(|isoline| isoline.label).collect()
    }

    #[test]
    fn small_numbers_are_powers_of_ten_and_others_have_two_digits() {
        for (value, text) in [
            (0.590_43, "0.59"),
            (0.036_2, "0.036"),
            (1.2256, "1.2"),
            (0.000_999_9, "1.0·10⁻³"),
            (2.469_75e-4, "2.5·10⁻⁴"),
            (-2.5e-12, "−2.5·10⁻¹²"),
            (0.0, "0.0"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn lines_are_at_round_values_that_part_the_map() {
        assert_eq!(
            labels(one_two_five(&grid(|x| -100.0 * x))),
            ["−50", "−20", "−10", "−5"]
        );
        assert_eq!(
            labels(around_one(&grid(|x| 0.94 + 0.08 * x))),
            ["0.95", "0.98", "0.99", "0.995", "1.002", "1.01", "1"]
        );
    }

    #[test]
    fn a_map_that_spans_decades_has_few_lines_and_a_constant_one_none() {
        let lines = one_two_five(&grid(|x| 10_f64.powf(6.0 * x - 3.0)));
        assert!((4..=MOST_ISOLINES).contains(&lines.len()), "{lines:?}");
        assert!(lines.is_sorted_by(|one, other| one.value < other.value));
        assert_eq!(one_two_five(&grid(|_| 5.0)), []);
        assert_eq!(one_two_five(&grid(|_| f64::NAN)), []);
    }
}
