//! The noise of a signal whose true value does not change.

use super::{mean, median};
use crate::Interval;

/// Length of a window, s: slower noise is a bias that walks, and faster noise cancels before it
/// moves a speed or an angle.
const WINDOW_S: f64 = 0.1;

/// Least number of windows.
const MIN_WINDOWS: usize = 20;

/// The noise of a signal, in the signal's unit U.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SignalNoise {
    /// Standard deviation of a sample, U.
    pub(crate) deviation: f64,
    /// Density of white noise whose integrals over 0.1 s scatter as those of the signal, U/√Hz.
    pub(crate) density: Interval,
}

/// The noise in runs of samples, each a time in s and a value. The mean of each run is taken for
/// its true value. None if there are fewer than 20 windows of 0.1 s.
pub(crate) fn signal_noise(runs: &[Vec<[f64; 2]>]) -> Option<SignalNoise> {
    let mut squares = [0.0; 2];
    let mut counts = [0_usize; 2];
    for run in runs {
        let values: Vec<f64> = run.iter().map(|[_, value]| *value).collect();
        let periods: Vec<f64> = run.windows(2).map(|pair| pair[1][0] - pair[0][0]).collect();
        let (Some(middle), Some(period)) = (mean(&values), median(&periods)) else {
            continue;
        };
        let windows = windows(run, period);
        if windows.is_empty() {
            continue;
        }
        squares[0] += values.iter().map(|v| (v - middle).powi(2)).sum::<f64>();
        squares[1] += windows
            .iter()
            .map(|[length, value]| length * (value - middle).powi(2))
            .sum::<f64>();
        // The mean of the run takes one freedom.
        counts[0] += values.len() - 1;
        counts[1] += windows.len() - 1;
    }
    if counts[1] < MIN_WINDOWS {
        return None;
    }
    let [deviation, density] = [0, 1].map(|i| (squares[i] / counts[i] as f64).sqrt());
    // The relative error of a standard deviation with n freedoms is 1 / sqrt(2 n).
    let half = 1.96 * density / (2.0 * counts[1] as f64).sqrt();
    Some(SignalNoise {
        deviation,
        density: Interval::around(density, half),
    })
}

/// Length in s and mean value of each whole window. A window with a gap is dropped.
fn windows(run: &[[f64; 2]], period: f64) -> Vec<[f64; 2]> {
    if period <= 0.0 {
        return Vec::new();
    }
    let count = ((WINDOW_S / period).round() as usize).max(1);
    let length = count as f64 * period;
    run.chunks_exact(count)
        .filter(|chunk| match (chunk.first(), chunk.last()) {
            (Some([first, _]), Some([last, _])) => last - first + period < 1.2 * length,
            _ => false,
        })
        .filter_map(|chunk| Some([length, mean(chunk.iter().map(|[_, value]| *value))?]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use singletrack_statistics::Random;

    fn white(seed: u64, samples: u32, period: f64, deviation: f64) -> Vec<[f64; 2]> {
        let mut noise = Random::new(seed);
        (0..samples)
            .map(|i| [f64::from(i) * period, 3.0 + deviation * noise.normal(1.0)])
            .collect()
    }

    #[test]
    fn white_noise_has_its_deviation_and_density() {
        for (period, samples) in [(0.005, 2_400), (0.01, 1_200), (0.1, 120)] {
            let mut inside = 0;
            for seed in 0..40 {
                let runs = [0, 1, 2].map(|i| white(3 * seed + i, samples, period, 0.2));
                let noise = signal_noise(&runs).unwrap();
                assert!((noise.deviation / 0.2 - 1.0).abs() < 0.2, "{noise:?}");
                inside += usize::from(noise.density.contains(0.2 * period.sqrt()));
            }
            assert!(inside >= 34, "{inside} of 40");
        }
    }

    #[test]
    fn fast_vibration_has_a_deviation_and_no_density() {
        // 35 Hz, sampled at 100 Hz.
        let run = (0..1_000)
            .map(|i| f64::from(i) * 0.01)
            .map(|t| [t, (220.0 * t).sin()])
            .collect();
        let noise = signal_noise(&[run]).unwrap();
        assert!((noise.deviation - 0.707).abs() < 0.01, "{noise:?}");
        assert!(noise.density.value < 0.03, "{noise:?}");
    }

    #[test]
    fn too_few_samples_and_gaps_give_nothing() {
        assert_eq!(signal_noise(&[]), None);
        assert_eq!(signal_noise(&[Vec::new(), vec![[0.0, 1.0]]]), None);
        assert_eq!(signal_noise(&[white(1, 100, 0.01, 1.0)]), None);
        assert_eq!(signal_noise(&[vec![[1.0, 1.0]; 1_000]]), None);
        // Every window has a gap.
        let run = (0..1_000)
            .map(|i| [f64::from(i) * 0.01 + f64::from(i / 5) * 0.5, 1.0])
            .collect();
        assert_eq!(signal_noise(&[run]), None);
    }
}
