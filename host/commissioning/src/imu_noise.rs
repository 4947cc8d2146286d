//! The IMU's noise, compared with what `[estimator]` believes.
//!
//! Wheels that turn in the air shake the car less than a floor does: what is measured is the least
//! that has to be believed, and never a reason to believe less.

use singletrack_control::Time;
use singletrack_control::statistics::Line;
use singletrack_core::config::EstimatorSection;

use super::fit::{mean, median};
use crate::{Inertial, Interval, Parameter};

/// Measured over believed noise from which the belief is too small.
const TOO_SMALL: f64 = 1.3;

const GYRO: &str = "estimator.gyro_noise_density_rad_s_per_sqrt_hz";
const REST: &str = "estimator.acceleration_noise_density_m_s2_per_sqrt_hz";
const VIBRATION: &str = "estimator.vibration_noise_density_m_s2_per_sqrt_hz_per_m_s";

/// Name and unit of each parameter, and the key that takes it.
const PARAMETERS: [(&str, &str, &str); 3] = [
    ("gyro-noise-density", "rad/s/sqrt(Hz)", GYRO),
    ("acceleration-noise-density", "m/s2/sqrt(Hz)", REST),
    ("vibration-noise-density", "m/s2/sqrt(Hz)/(m/s)", VIBRATION),
];

/// The noise of the IMU while the wheels turn at one speed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoiseLevel {
    /// Mean speed of the wheels, m/s.
    pub(crate) speed: f64,
    /// Noise of the acceleration forward, m/s².
    pub(crate) forward: SignalNoise,
    /// Noise of the acceleration to the left, m/s².
    pub(crate) left: SignalNoise,
    /// Noise of the yaw rate, rad/s.
    pub(crate) yaw_rate: SignalNoise,
}

/// What the estimator believes of the IMU, in the units of the configuration.
#[derive(Clone, Copy, Debug)]
struct Belief {
    gyro: f64,
    rest: f64,
    vibration: f64,
}

/// The comparison with the configuration.
#[derive(Clone, Debug, Default)]
pub(crate) struct Comparison {
    /// What was measured and what is believed, a text for each speed.
    pub(crate) found: Vec<String>,
    /// The keys whose value is too small, each with that value and the proposed one.
    pub(crate) too_small: Vec<String>,
    /// What was measured; with a key where a larger value is proposed.
    pub(crate) parameters: Vec<Parameter>,
}

impl NoiseLevel {
    /// From runs of samples at one speed; none if there are too few.
    pub(crate) fn of(speed: f64, runs: &[Vec<Inertial>]) -> Option<Self> {
        let signal = |value: fn(&Inertial) -> f64| {
            let runs = runs.iter().map(|run| {
                let begin = run.first().map_or(Time(0), |first| first.time);
                let at = |sample: &Inertial| [sample.time.seconds_since(begin), value(sample)];
                run.iter().map(at).collect()
            });
            signal_noise(&runs.collect::<Vec<_>>())
        };
        Some(Self {
            speed,
            forward: signal(|sample| sample.acceleration[0])?,
            left: signal(|sample| sample.acceleration[1])?,
            yaw_rate: signal(|sample| sample.angular_velocity[2])?,
        })
    }

    /// Density of the noisier of both accelerations, m/s²/√Hz.
    pub(crate) fn acceleration(&self) -> f64 {
        self.forward.density.value.max(self.left.density.value)
    }
}

impl Belief {
    /// Believed density of the acceleration's noise at a speed in m/s, m/s²/√Hz.
    fn acceleration(&self, speed: f64) -> f64 {
        self.rest.hypot(self.vibration * speed)
    }

    /// The least belief of this form that holds at each of these speeds.
    fn of(levels: &[NoiseLevel]) -> Self {
        let gyro = levels.iter().map(|level| level.yaw_rate.density.value);
        let gyro = gyro.fold(0.0, f64::max);
        let rest = levels.iter().filter(|level| level.speed == 0.0);
        let rest = rest.map(NoiseLevel::acceleration).fold(0.0, f64::max);
        // A line through the powers over the squared speeds, of wheels that turn.
        let turning = levels.iter().filter(|level| level.speed > 0.0);
        let line =
            Line::through(turning.map(|level| [level.speed.powi(2), level.acceleration().powi(2)]));
        let [x, y] = line.middle;
        let slope = line.slope.max(0.0);
        let (quiet, offset) = (rest * rest, y - slope * x);
        let (power, slope) = if line.spread > 0.0 && offset >= quiet {
            (offset, slope)
        } else if x > 0.0 {
            // Through the noise at rest: there is no less.
            (quiet, ((y - quiet) / x).max(0.0))
        } else {
            (quiet, 0.0)
        };
        let line = Self {
            gyro,
            rest: power.sqrt(),
            vibration: slope.sqrt(),
        };
        // A resonance lies above the line.
        let above = levels
            .iter()
            .map(|level| level.acceleration() / line.acceleration(level.speed))
            .filter(|ratio| ratio.is_finite())
            .fold(1.0, f64::max);
        Self {
            rest: line.rest * above,
            vibration: line.vibration * above,
            ..line
        }
    }
}

/// Compares the noise at some speeds with the configuration.
pub(crate) fn compare(levels: &[NoiseLevel], estimator: &EstimatorSection) -> Comparison {
    if levels.is_empty() {
        return Comparison::default();
    }
    let believed = Belief {
        gyro: estimator.gyro_noise_density_rad_s_per_sqrt_hz,
        rest: estimator.acceleration_noise_density_m_s2_per_sqrt_hz,
        vibration: estimator.vibration_noise_density_m_s2_per_sqrt_hz_per_m_s,
    };
    let measured = Belief::of(levels);
    let found = levels.iter().map(|level| {
        let when = match level.speed {
            0.0 => "at rest".to_owned(),
            speed => format!("at {speed:.2} m/s"),
        };
        format!(
            "{when}: acceleration {:.3} forward and {:.3} m/s² left a sample, {} and {} m/s²/√Hz \
             (believed {}); yaw rate {:.4} rad/s a sample, {} rad/s/√Hz (believed {})",
            level.forward.deviation,
            level.left.deviation,
            digits(level.forward.density.value),
            digits(level.left.density.value),
            digits(believed.acceleration(level.speed)),
            level.yaw_rate.deviation,
            digits(level.yaw_rate.density.value),
            digits(believed.gyro),
        )
    });
    let mut comparison = Comparison {
        found: found.collect(),
        ..Comparison::default()
    };
    let is_shaken = levels
        .iter()
        .any(|level| level.acceleration() > TOO_SMALL * believed.acceleration(level.speed));
    // The densities of all levels have nearly the same relative error.
    let densities = levels.iter().map(|level| level.yaw_rate.density);
    let error = densities
        .map(|density| density.half_width() / density.value)
        .filter(|error| error.is_finite())
        .fold(0.0, f64::max);
    let turns = levels.iter().any(|level| level.speed > 0.0);
    let values = [
        [measured.gyro, believed.gyro],
        [measured.rest, believed.rest],
        [measured.vibration, believed.vibration],
    ];
    for ((name, unit, key), [measured, believed]) in PARAMETERS.into_iter().zip(values) {
        if key == VIBRATION && !turns {
            continue;
        }
        let is_too_small = match key {
            GYRO => measured > TOO_SMALL * believed,
            _ => is_shaken,
        };
        let proposed = rounded_up(measured);
        let estimate = Interval::around(measured, error * measured);
        let mut parameter = Parameter::new(name, unit, estimate);
        if is_too_small && proposed > believed {
            parameter = parameter.written(key, proposed);
            let believed = digits(believed);
            let text = format!("{key} is {believed}, measured {proposed}");
            comparison.too_small.push(text);
        }
        comparison.parameters.push(parameter);
    }
    comparison
}

/// Three significant digits.
fn digits(value: f64) -> String {
    if value <= 0.0 {
        return "0".to_owned();
    }
    let places = (2.0 - value.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.places$}")
}

/// The next number with two significant digits.
fn rounded_up(value: f64) -> f64 {
    if value <= 0.0 {
        return 0.0;
    }
    let places = (1.0 - value.log10().floor()).clamp(0.0, 9.0) as i32;
    let scale = 10_f64.powi(places);
    (value * scale).ceil() / scale
}

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
    let whole = run
        .chunks_exact(count)
        .filter(|chunk| chunk[count - 1][0] - chunk[0][0] + period < 1.2 * length);
    whole
        .filter_map(|chunk| Some([length, mean(chunk.iter().map(|[_, value]| *value))?]))
        .collect()
}

#[cfg(test)]
mod tests {
    use singletrack_control::statistics::Random;
    use singletrack_core::Config;

    use super::*;

    fn level(speed: f64, acceleration: f64, yaw_rate: f64) -> NoiseLevel {
        let noise = |density| SignalNoise {
            deviation: 10.0 * density,
            density: Interval::around(density, 0.1 * density),
        };
        NoiseLevel {
            speed,
            forward: noise(acceleration),
            left: noise(0.9 * acceleration),
            yaw_rate: noise(yaw_rate),
        }
    }

    /// The defaults.
    fn section() -> EstimatorSection {
        let text = include_str!("../../daemon/singletrackd.example.toml");
        Config::from_toml(text).unwrap().estimator
    }

    #[test]
    fn a_noise_of_the_believed_form_is_found() {
        let levels = [0.0, 0.25, 0.5, 0.75].map(|v: f64| level(v, 0.02_f64.hypot(0.3 * v), 0.004));
        let belief = Belief::of(&levels);
        assert!((belief.rest - 0.02).abs() < 1e-9, "{belief:?}");
        assert!((belief.vibration - 0.3).abs() < 1e-9, "{belief:?}");
        assert_eq!(belief.gyro, 0.004);
    }

    #[test]
    fn the_proposal_covers_every_level() {
        for noise in [
            [0.01, 0.2, 0.2, 0.2],
            [0.01, 0.3, 0.1, 0.3],
            [0.01, 0.02, 0.3, 0.05],
            [0.5, 0.1, 0.2, 0.3],
            [0.0, 0.0, 0.0, 0.1],
        ] {
            let speeds = [0.0, 0.3, 0.5, 0.7];
            let levels: Vec<_> = speeds
                .into_iter()
                .zip(noise)
                .map(|(speed, noise)| level(speed, noise, 0.001))
                .collect();
            let belief = Belief::of(&levels);
            for level in &levels {
                let believed = belief.acceleration(level.speed);
                assert!(
                    believed >= 0.999 * level.acceleration(),
                    "{noise:?} {belief:?}"
                );
            }
        }
    }

    #[test]
    fn a_quiet_car_proposes_nothing() {
        let levels = [level(0.0, 0.006, 0.000_3), level(0.5, 0.02, 0.001)];
        let comparison = compare(&levels, &section());
        assert!(comparison.too_small.is_empty(), "{comparison:?}");
        assert_eq!(comparison.found.len(), 2);
        assert_eq!(comparison.parameters.len(), 3);
        assert!(comparison.parameters.iter().all(|one| one.key.is_none()));
    }

    #[test]
    fn too_small_beliefs_are_named_with_the_measured_value() {
        let levels = [level(0.0, 0.006, 0.000_3), level(0.5, 0.21, 0.007_01)];
        let section = EstimatorSection {
            gyro_noise_density_rad_s_per_sqrt_hz: 0.000_5,
            ..section()
        };
        let comparison = compare(&levels, &section);
        assert_eq!(
            comparison.too_small,
            [
                format!("{GYRO} is 0.000500, measured 0.0071"),
                format!("{VIBRATION} is 0.100, measured 0.42"),
            ]
        );
        let keys: Vec<_> = comparison
            .parameters
            .iter()
            .filter_map(|one| one.key.as_ref().map(|(key, _)| key.as_ref()))
            .collect();
        assert_eq!(keys, [GYRO, VIBRATION]);
    }

    #[test]
    fn a_car_at_rest_says_nothing_of_its_vibration() {
        let comparison = compare(&[level(0.0, 0.2, 0.001)], &section());
        assert_eq!(
            comparison.too_small,
            [format!("{REST} is 0.0500, measured 0.2")]
        );
        assert_eq!(comparison.parameters.len(), 2);
    }

    #[test]
    fn no_level_gives_no_finding() {
        let comparison = compare(&[], &section());
        assert!(comparison.found.is_empty() && comparison.parameters.is_empty());
    }

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
