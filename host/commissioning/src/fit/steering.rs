<<<<<<< HEAD
//! The steering servo, from a drive with bends.

use super::{Motion, Signal, gauss_newton};

/// The steering servo, as one pass shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steering {
    /// Pulse for straight wheels, µs.
    pub centre_us: f64,
    /// Pulse per angle to the left, µs/rad.
    pub gain_us_per_rad: f64,
    /// Time constant, s.
    pub lag: f64,
    /// Time from the pulse in the telemetry to the first movement, s.
    pub delay: f64,
    /// Play, µs.
    pub play_us: f64,
    /// How much more the car turns than the fit in bends to the left and to the right, as a
    /// fraction.
    pub excess: [f64; 2],
}

/// What is known of the car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// Distance of the axles, m.
    pub wheelbase: f64,
    /// Steering per lateral acceleration beyond that of the bend, rad per m/s².
    pub understeer: f64,
    /// Time in which the yaw rate follows the wheels, s.
    pub yaw_lag: f64,
}

/// The step of the simulated servo, s.
const STEP: f64 = 0.002;

/// Slower poses tell nothing of the steering, m/s.
const SLOWEST: f64 = 0.05;

/// Fits the servo to the yaw rate: `speed` is that of the rear axle at every pose. `about` is
/// where the search begins. None if the drive does not determine it.
#[must_use]
pub fn steering(
    motion: &Motion,
    pulses: &Signal,
    speed: &[f64],
    turning: &Turning,
    about: [f64; 2],
) -> Option<Steering> {
    let [centre_us, gain_us_per_rad] = about;
    let residuals = |parameters: &[f64; 5]| residuals(motion, pulses, speed, turning, parameters);
    let start = [centre_us, 1_000.0 / gain_us_per_rad, 0.04, 0.02, 3.0];
    let reach = 1_000.0 / gain_us_per_rad.abs();
    let bounds = [
        [centre_us - 200.0, centre_us + 200.0],
        // Its sign is known.
        [0.3 * reach, 3.0 * reach].map(|gain| gain * gain_us_per_rad.signum()),
        [0.002, 0.3],
        [0.0, 0.2],
        [0.0, 40.0],
    ]
    .map(|[one, other]: [f64; 2]| [one.min(other), one.max(other)]);
    let scale = [0.5, 0.01, 0.001, 0.001, 0.5];
    let found = gauss_newton(start, scale, bounds, residuals)?;
    let [centre_us, inverse, lag, delay, play_us] = found;
    let mut sums = [[0.0; 2]; 2];
    for (residual, rate) in residuals(&found).iter().zip(&motion.yaw_rate) {
        let side = usize::from(*rate < 0.0);
        sums[side][0] += residual * rate.signum();
        sums[side][1] += rate.abs();
    }
    Some(Steering {
        centre_us,
        gain_us_per_rad: 1_000.0 / inverse,
        lag,
        delay,
        play_us,
        excess: sums.map(|[excess, turned]| if turned > 0.0 { excess / turned } else { 0.0 }),
    })
}

fn residuals(
    motion: &Motion,
    pulses: &Signal,
    speed: &[f64],
    turning: &Turning,
    &[centre_us, inverse, lag, delay, play_us]: &[f64; 5],
) -> Vec<f64> {
    let Some(&start) = motion.time.first() else {
        return Vec::new();
    };
    let delay = delay + turning.yaw_lag;
    let mut held = pulses.at(start - delay);
    let angle = |pulse: f64| (pulse - centre_us) * inverse * 1e-3;
    let mut wheels = angle(held);
    let mut now = start;
    let share = 1.0 - (-STEP / lag).exp();
    motion
        .time
        .iter()
        .zip(&motion.yaw_rate)
        .zip(speed)
        .map(|((&time, &rate), &speed)| {
            while now + STEP <= time {
                now += STEP;
                let pulse = pulses.at(now - delay);
                held = held.clamp(pulse - 0.5 * play_us, pulse + 0.5 * play_us);
                wheels += share * (angle(held) - wheels);
            }
            if speed < SLOWEST {
                return 0.0;
            }
            // The remaining part of a step, as if the wheels moved evenly.
            let at = wheels + share * (angle(held) - wheels) * (time - now) / STEP;
            let length = turning.wheelbase + turning.understeer * speed * speed;
            rate - speed * at.tan() / length
        })
        .collect()
=======
//! The servo's map from angles that a person has read.

use super::student_quantile;
use crate::Interval;

/// What the readings say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steering {
    /// Pulse for one radian to the left, us/rad.
    pub(crate) gain: Interval,
    /// Pulse that reads zero, us. The error that all readings share is not in it.
    pub(crate) straight: Interval,
    /// Standard deviation of the readings, rad.
    pub(crate) scatter: f64,
}

/// Fits a line through readings, each a pulse in us and an angle in rad.
///
/// A reading scatters by `least_scatter` at least, whatever these say, and all of them share
/// a relative error of `scale` (95 %). `None` if they show no slope.
pub(crate) fn fit_steering(
    readings: &[[f64; 2]],
    least_scatter: f64,
    scale: f64,
) -> Option<Steering> {
    let count = readings.len() as f64;
    if readings.len() < 3 {
        return None;
    }
    let mean = |index: usize| readings.iter().map(|reading| reading[index]).sum::<f64>() / count;
    let (pulse, angle) = (mean(0), mean(1));
    let sum = |of: &dyn Fn(&[f64; 2]) -> f64| readings.iter().map(of).sum::<f64>();
    let spread = sum(&|reading| (reading[0] - pulse).powi(2));
    let slope = sum(&|reading| (reading[0] - pulse) * (reading[1] - angle)) / spread;
    let residual = |reading: &[f64; 2]| reading[1] - angle - slope * (reading[0] - pulse);
    let freedom = readings.len() - 2;
    let scatter = (sum(&|reading| residual(reading).powi(2)) / freedom as f64).sqrt();
    let believed = scatter.max(least_scatter);
    let t = student_quantile(freedom);
    let random = t * believed / spread.sqrt();
    let half = random.hypot(scale * slope);
    if !slope.is_finite() || slope.abs() <= half {
        return None;
    }
    let ends = [1.0 / (slope - half), 1.0 / (slope + half)];
    let zero = pulse - angle / slope;
    let at_zero = believed * (1.0 / count + (zero - pulse).powi(2) / spread).sqrt();
    Some(Steering {
        gain: Interval {
            value: 1.0 / slope,
            low: ends[0].min(ends[1]),
            high: ends[0].max(ends[1]),
        },
        straight: Interval::around(zero, t * at_zero / slope.abs()),
        scatter,
    })
}

#[cfg(test)]
mod tests {
    use super::fit_steering;
    use crate::fit::tests::Noise;

    #[test]
    fn the_interval_holds_the_gain_in_19_of_20_sets_of_readings() {
        let mut noise = Noise::new(1);
        let mut held = [0; 2];
        for _ in 0..1_000 {
            let gain = (600.0 + 500.0 * noise.uniform()) * (1.0_f64).copysign(noise.normal());
            let centre = 1_450.0 + 100.0 * noise.uniform();
            let scale = 1.0 + 0.01 * noise.normal();
            let readings: Vec<_> = (0..12)
                .map(|index| {
                    let pulse = 1_200.0 + 50.0 * f64::from(index);
                    let angle = scale * (pulse - centre) / gain;
                    [pulse, angle + 0.0175 * noise.normal()]
                })
                .collect();
            let fit = fit_steering(&readings, 0.01, 0.02).unwrap();
            held[0] += u32::from(fit.gain.low <= gain && gain <= fit.gain.high);
            held[1] += u32::from((fit.straight.low..=fit.straight.high).contains(&centre));
        }
        assert!(held.iter().all(|held| (930..=990).contains(held)), "{held:?}");
    }

    #[test]
    fn readings_without_a_slope_give_no_gain() {
        let level = [[1_400.0, 0.1], [1_500.0, 0.11], [1_600.0, 0.09]];
        assert!(fit_steering(&level, 0.0175, 0.02).is_none());
        let same = [[1_500.0, 0.1]; 5];
        assert!(fit_steering(&same, 0.0175, 0.02).is_none());
    }

    #[test]
    fn readings_without_scatter_are_believed_to_the_least_scatter_only() {
        let readings = [-300.0, -150.0, 0.0, 150.0, 300.0].map(|way| [1_500.0 + way, way / 800.0]);
        let fit = fit_steering(&readings, 0.0175, 0.0).unwrap();
        assert!((fit.gain.value - 800.0).abs() < 1e-9);
        assert!(fit.gain.high - fit.gain.low > 50.0, "{:?}", fit.gain);
    }
>>>>>>> cdd31e78be8085778cbb287b3faee8368e13fc07
}
