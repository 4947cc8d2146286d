//! Nonlinear least squares with a few parameters.

use super::least_squares;

/// The steps of the iteration.
const STEPS: usize = 60;

/// The parameters near `start` that make the residuals least. `scale` is a step by which each
/// parameter may be changed for its derivative, and `bounds` is where it must stay. None if the
/// residuals do not determine the parameters.
pub(crate) fn gauss_newton<const N: usize>(
    start: [f64; N],
    scale: [f64; N],
    bounds: [[f64; 2]; N],
    residuals: impl Fn(&[f64; N]) -> Vec<f64>,
) -> Option<[f64; N]> {
    let within = |mut parameters: [f64; N]| {
        for (value, [low, high]) in parameters.iter_mut().zip(bounds) {
            *value = value.clamp(low, high);
        }
        parameters
    };
    let squares = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
    let mut best = within(start);
    let mut residual = residuals(&best);
    let mut least = squares(&residual);
    for _ in 0..STEPS {
        let shifted: Vec<Vec<f64>> = (0..N)
            .map(|index| {
                let mut near = best;
                near[index] += scale[index];
                residuals(&near)
            })
            .collect();
        let rows = residual.iter().enumerate().map(|(row, value)| {
            let slopes: [f64; N] = std::array::from_fn(|i| value - shifted[i][row]);
            (slopes, *value)
        });
        let step = least_squares(rows)?.parameters;
        let mut share = 1.0;
        let mut has_moved = false;
        // Shorter steps, if a whole one leads too far.
        for _ in 0..6 {
            let next = within(std::array::from_fn(|i| {
                best[i] + share * step[i] * scale[i]
            }));
            let found = residuals(&next);
            let sum = squares(&found);
            if sum < least {
                has_moved = (least - sum) > 1e-9 * least;
                (best, residual, least) = (next, found, sum);
                break;
            }
            share *= 0.4;
        }
        if !has_moved {
            break;
        }
    }
    best.iter().all(|value| value.is_finite()).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use singletrack_statistics::Random;

    #[test]
    fn an_exponential_is_found_from_far_and_stays_within_its_bounds() {
        let mut noise = Random::new(5);
        let data: Vec<(f64, f64)> = (0..400)
            .map(|index| {
                let time = 0.01 * f64::from(index);
                (
                    time,
                    2.0 * (1.0 - (-time / 0.7).exp()) + 0.01 * noise.normal(1.0),
                )
            })
            .collect();
        let fit = |bounds| {
            gauss_newton([0.5, 0.1], [1e-3, 1e-3], bounds, |[level, lag]| {
                data.iter()
                    .map(|(time, value)| value - level * (1.0 - (-time / lag).exp()))
                    .collect()
            })
            .unwrap()
        };
        let [level, lag] = fit([[0.0, 10.0], [0.01, 5.0]]);
        assert!(
            (level - 2.0).abs() < 0.01 && (lag - 0.7).abs() < 0.01,
            "{level} {lag}"
        );
        let [_, lag] = fit([[0.0, 10.0], [0.01, 0.5]]);
        assert!((lag - 0.5).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_effect_is_not_determined() {
        let found = gauss_newton([1.0, 1.0], [0.1, 0.1], [[0.0, 9.0]; 2], |[level, _]| {
            vec![level - 2.0, level - 3.0, level - 1.0]
        });
        assert_eq!(found, None);
    }
}
