//! The steering servo, from a drive with bends.

use super::{Motion, Signal, gauss_newton};

/// The steering servo, as one pass shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheels {
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
pub fn wheels(
    motion: &Motion,
    pulses: &Signal,
    speed: &[f64],
    turning: &Turning,
    about: [f64; 2],
) -> Option<Wheels> {
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
    Some(Wheels {
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
    let mut turned = angle(held);
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
                turned += share * (angle(held) - turned);
            }
            if speed < SLOWEST {
                return 0.0;
            }
            // The remaining part of a step, as if the wheels moved evenly.
            let at = turned + share * (angle(held) - turned) * (time - now) / STEP;
            let length = turning.wheelbase + turning.understeer * speed * speed;
            rate - speed * at.tan() / length
        })
        .collect()
}
