//! ESC, motor and gears, from changes of the speed.

use super::{Signal, gauss_newton};

/// How the speed follows the ESC's pulse, as one change of the speed shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveTrain {
    /// Pulse per speed, µs/(m/s).
    pub us_per_m_s: f64,
    /// Pulse at which the speed would be zero, µs.
    pub edge_us: f64,
    /// Time constant, s.
    pub lag: f64,
    /// Time from the pulse in the telemetry to the first change, s.
    pub delay: f64,
}

/// The step of the simulated motor, s.
const STEP: f64 = 0.002;

/// Fits the way of the rear axle (times in s, ways in m) through a change to a higher speed.
/// `about` is the pulse per speed and that at zero speed where the search begins. None if it is
/// not determined.
#[must_use]
pub fn drive_train(
    time: &[f64],
    way: &[f64],
    pulses: &Signal,
    about: [f64; 2],
) -> Option<DriveTrain> {
    let (start, first) = (*time.first()?, *way.first()?);
    let near = time.iter().take_while(|t| **t < start + 0.2).count();
    let (late, after) = (time.get(near)?, way.get(near)?);
    let speed = (after - first) / (late - start);
    let [us_per_m_s, edge_us] = about;
    let scale = [0.01, 0.5, 0.002, 0.002, 1e-4, 1e-3];
    let begin = [1_000.0 / us_per_m_s, edge_us, 0.08, 0.03, first, speed];
    let bounds = [
        [0.1 * begin[0], 10.0 * begin[0]],
        [edge_us - 100.0, edge_us + 100.0],
        [0.005, 0.6],
        [0.0, 0.2],
        [first - 0.1, first + 0.1],
        [-0.1, 3.0],
    ];
    let [gain, edge_us, lag, delay, ..] = gauss_newton(
        begin,
        scale,
        bounds,
        |&[gain, edge, lag, delay, at, speed]| {
            let share = 1.0 - (-STEP / lag).exp();
            let (mut now, mut position, mut speed) = (start, at, speed);
            time.iter()
                .zip(way)
                .map(|(&time, &way)| {
                    while now + STEP <= time {
                        now += STEP;
                        let wanted = (pulses.at(now - delay) - edge) * gain * 1e-3;
                        let change = share * (wanted.max(0.0) - speed);
                        position += (speed + 0.5 * change) * STEP;
                        speed += change;
                    }
                    way - position - speed * (time - now)
                })
                .collect()
        },
    )?;
    Some(DriveTrain {
        us_per_m_s: 1_000.0 / gain,
        edge_us,
        lag,
        delay,
    })
}

/// The deceleration of the rear axle over these times, m/s², by a parabola. None of fewer than
/// four.
#[must_use]
pub fn deceleration(time: &[f64], way: &[f64]) -> Option<f64> {
    let start = *time.first()?;
    let rows = time.iter().zip(way).map(|(time, way)| {
        let t = time - start;
        ([1.0, t, t * t], *way)
    });
    (time.len() >= 4)
        .then(|| super::least_squares(rows))?
        .map(|fit| -2.0 * fit.parameters[2])
}
