//! The spectrum of what a sensor measures beyond the motion of the car.

use core::f64::consts::TAU;

use singletrack_control::Time;

/// Samples of a segment.
const SEGMENT: usize = 64;
/// Samples that are farther apart than this many times the usual interval begin a new segment.
const APART: f64 = 1.5;

/// The one-sided density of a signal over the frequency, in Hz and in its unit per root of a Hz: the
/// mean over half-overlapping segments with a Hann window (Welch). Empty without a whole segment.
pub(super) fn density(samples: &[(Time, f64)]) -> Vec<(f64, f64)> {
    let mut intervals: Vec<f64> = samples
        .windows(2)
        .filter_map(|pair| match pair {
            [(one, _), (other, _)] => Some(other.seconds_since(*one)),
            _ => None,
        })
        .collect();
    intervals.sort_by(f64::total_cmp);
    let Some(&interval) = intervals.get(intervals.len() / 2) else {
        return Vec::new();
    };
    let mut sums = [0.0; SEGMENT / 2];
    let mut segments = 0.0;
    for segment in samples.windows(SEGMENT).step_by(SEGMENT / 2) {
        let whole = segment.windows(2).all(|pair| match pair {
            [(one, _), (other, _)] => other.seconds_since(*one) < APART * interval,
            _ => false,
        });
        if !whole {
            continue;
        }
        segments += 1.0;
        let mean = segment.iter().map(|(_, value)| value).sum::<f64>() / SEGMENT as f64;
        for (bin, sum) in sums.iter_mut().enumerate() {
            let (mut real, mut imaginary) = (0.0, 0.0);
            for (index, (_, value)) in segment.iter().enumerate() {
                let turn = TAU * index as f64 / SEGMENT as f64;
                let windowed = (value - mean) * 0.5 * (1.0 - libm::cos(turn));
                let (sine, cosine) = libm::sincos(bin as f64 * turn);
                real += windowed * cosine;
                imaginary -= windowed * sine;
            }
            *sum += real * real + imaginary * imaginary;
        }
    }
    if segments == 0.0 {
        return Vec::new();
    }
    // The mean square of the window is 3/8.
    let power = 2.0 * interval / (segments * 0.375 * SEGMENT as f64);
    let frequency = 1.0 / (interval * SEGMENT as f64);
    sums.iter()
        .enumerate()
        .skip(1)
        .map(|(bin, sum)| (bin as f64 * frequency, (sum * power).sqrt()))
        .collect()
}

#[cfg(test)]
mod tests {
    use singletrack_statistics::Random;

    use super::*;

    fn signal(every_ms: u64, value: impl Fn(f64) -> f64) -> Vec<(Time, f64)> {
        (0..4_000)
            .map(|index| {
                let time = Time(index * every_ms * 1_000_000);
                (time, value((index * every_ms) as f64 * 1e-3))
            })
            .collect()
    }

    #[test]
    fn white_noise_has_its_density_at_every_frequency() {
        // Uniform between -1 and 1, ten and a hundred times a second: 1/3 over half the rate.
        for (every_ms, density_of_it) in [
            (100, (1.0_f64 / 15.0).sqrt()),
            (10, (1.0_f64 / 150.0).sqrt()),
        ] {
            let random = core::cell::RefCell::new(Random::new(1));
            let noise = signal(every_ms, |_| random.borrow_mut().between(-1.0, 1.0));
            let found = density(&noise);
            assert_eq!(found.len(), SEGMENT / 2 - 1);
            let mean =
                found.iter().map(|(_, value)| value * value).sum::<f64>() / found.len() as f64;
            let ratio = mean.sqrt() / density_of_it;
            assert!((ratio - 1.0).abs() < 0.1, "{every_ms} ms: {ratio}");
        }
    }

    #[test]
    fn a_vibration_stands_at_its_frequency_and_segments_do_not_cross_gaps() {
        let mut shaken = signal(10, |time| libm::sin(TAU * 12.5 * time));
        let found = density(&shaken);
        let highest = found.iter().max_by(|one, other| one.1.total_cmp(&other.1));
        assert!((highest.unwrap().0 - 12.5).abs() < 0.1);
        shaken.retain(|(time, _)| time.0 % 300_000_000 != 0);
        assert_eq!(density(&shaken), []);
        assert_eq!(density(&[]), []);
    }
}
